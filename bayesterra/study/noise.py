"""Measurement noise of a channel: given (absolute, relative with a floor, per row) or estimated.

Its law is Gaussian, Student's with given degrees of freedom, whose tails let single readings be far out, or one's own.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bayesterra.arrays import FloatArray
from bayesterra.errors import StudyError, check_number
from bayesterra.parameters import NOISE_PREFIX
from bayesterra.stats.laws import Law
from bayesterra.stats.tails import GAUSSIAN, OwnTails, StudentT, Tails

LEAST = 1e-15
"""SI, at least, of a given standard deviation."""


@dataclass(frozen=True)
class Noise:
    """Noise of one channel; exactly one of ``sd``, ``fraction`` and ``law`` is given.

    Parameters
    ----------
    channel : name of the measured channel.
    sd : standard deviation, SI unit of the channel.
    fraction, floor : standard deviation max(fraction · |modelled value|, floor). The modelled value is
        meant, so that simulation, likelihood and evidence use one and the same law.
    law : prior law of an unknown standard deviation, which is then estimated.
    dof : degrees of freedom of a Student-t law; infinite for a Gaussian one. What is called standard
        deviation here is then the scale of the law, which is less: σ √(dof / (dof − 2)) is the deviation.
    residuals : another law of residuals in units of what is called standard deviation.
    resolution : step to which readings are rounded, SI; 0 for readings of which every digit counts. The noise
        is what is there before rounding.
    """

    channel: str
    sd: float | None = None
    fraction: float | None = None
    floor: float = 0.0
    law: Law | None = None
    dof: float = np.inf
    resolution: float = 0.0
    residuals: OwnTails | None = None

    def __post_init__(self) -> None:
        if sum(size is not None for size in (self.sd, self.fraction, self.law)) != 1:
            raise StudyError(f"noise of '{self.channel}' must be one of: a value, a fraction, an estimate")
        for value in (self.sd, self.fraction, self.floor, self.dof, self.resolution):
            check_number(f"noise of '{self.channel}'", 0.0 if value is None else value)
        if self.sd is not None and not (self.sd > 0 and np.isfinite(self.sd)):
            raise StudyError(f"noise of '{self.channel}' must be above 0 (got {self.sd:g})")
        smallest = min(size for size in (self.sd, self.floor or None, np.inf) if size is not None)
        if smallest < LEAST:
            raise StudyError(f"noise of '{self.channel}' must be at least {LEAST:g} in SI units (got {smallest:g})")
        if self.fraction is not None and not (0 < self.fraction < 10 and self.floor > 0):
            raise StudyError(
                f"noise of '{self.channel}' needs a fraction above 0 and a floor above 0"
                f" (got {self.fraction:g} and {self.floor:g})"
            )
        if self.law is not None and not self.law.range[0] > 0:
            raise StudyError(f"estimated noise of '{self.channel}' needs a 'lower' above 0")
        if not self.dof >= 1:
            raise StudyError(f"'dof' of the noise of '{self.channel}' must be at least 1 (got {self.dof:g})")
        if self.residuals is not None and np.isfinite(self.dof):
            raise StudyError(f"noise of '{self.channel}' has 'dof' and 'residuals': state one of them")
        if not (0 <= self.resolution < np.inf) or 0 < self.resolution < LEAST:
            raise StudyError(
                f"'resolution' of '{self.channel}' must be at least {LEAST:g} in SI units, or 0 for none"
                f" (got {self.resolution:g})"
            )

    @property
    def parameter(self) -> str | None:
        """Name of the estimated standard deviation, None where the noise is given."""
        return NOISE_PREFIX + self.channel if self.law is not None else None

    def scale(self, predicted: FloatArray, estimated: FloatArray | None, given: FloatArray) -> FloatArray:
        """Standard deviation of every reading, its rounding included.

        Rounding to steps δ adds an error of variance δ²/12 (Sheppard 1898, Proc. London Math. Soc. 29, 353).
        """
        return self.widened(self.before_rounding(predicted, estimated, given))

    def widened(self, scale: FloatArray) -> FloatArray:
        """Standard deviations (any shape) with that of rounding."""
        return np.sqrt(scale**2 + self.resolution**2 / 12) if self.resolution else scale

    def before_rounding(self, predicted: FloatArray, estimated: FloatArray | None, given: FloatArray) -> FloatArray:
        """Standard deviation of every reading, before it is rounded.

        Parameters
        ----------
        predicted : modelled values (n, m), SI.
        estimated : values of the estimated standard deviation (n,), None where the noise is given.
        given : standard deviations from the table (m,), NaN where the row has none; they override.

        Returns
        -------
        Standard deviations, shape broadcastable to (n, m).
        """
        if self.sd is not None:
            scale: FloatArray = np.full((1, predicted.shape[1]), self.sd)
        elif self.fraction is not None:
            scale = np.maximum(self.fraction * np.abs(predicted), self.floor)
        elif estimated is None:
            raise ValueError(f"noise of '{self.channel}' is estimated: its value must be given")
        else:
            scale = np.broadcast_to(estimated[:, None], predicted.shape)
        return np.where(np.isnan(given), scale, given)

    def scaled(self, factor: float) -> "Noise":
        """The same with a stated size times ``factor``; an estimated one is as it is."""
        sd, fraction = (None if size is None else factor * size for size in (self.sd, self.fraction))
        return replace(self, sd=sd, fraction=fraction, floor=factor * self.floor)

    @cached_property
    def tails(self) -> Tails:
        """Law of the residuals in units of their standard deviation."""
        if self.residuals is not None:
            return self.residuals
        return GAUSSIAN if np.isinf(self.dof) else StudentT(self.dof)
