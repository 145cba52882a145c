"""Nested Monte Carlo: the expected information under a prior by brute force, as the reference."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.random import Generator
from scipy.special import logsumexp

from bayesterra.arrays import FloatArray
from bayesterra.design.candidates import Candidate, Reading, Situation, readings_of, standard_noise
from bayesterra.likelihood.posterior import INSIDE, Posterior, draw_cut_prior
from bayesterra.study.study import Study


@dataclass(frozen=True)
class Sizes:
    """Draws of a nested Monte Carlo: readings, and draws behind the density of each."""

    outer: int = 1000
    inner: int = 1000


def nested_gain(
    study: Study,
    posterior: Posterior,
    candidate: Candidate,
    about: tuple[str, ...],
    rng: Generator,
    sizes: Sizes = Sizes(),
) -> tuple[float, float]:
    """I(y; θ) = E log p(y | θ) − E log p(y) under the cut prior, nats, and its standard error.

    Both densities are means over fresh draws of the other parameters (Rainforth et al. 2018). Candidates of
    one row only.
    """
    x = draw_cut_prior(posterior, sizes.outer, rng).x
    (reading,) = readings_of(Situation(study, posterior, x, "prior"), candidate)
    y = reading.draw(standard_noise(reading, rng))
    marginal = draw_cut_prior(posterior, sizes.outer * 20, rng).x
    log_p = _log_mean(_predicted(study, posterior, marginal, candidate), y)
    columns = [posterior.names.index(name) for name in about]
    given = [_given(posterior, one[columns], columns, sizes.inner, rng) for one in x]
    blocks = _predicted(study, posterior, np.concatenate(given), candidate)
    ends = np.cumsum([0, *(len(block) for block in given)])
    log_given = [
        _log_mean(_part(blocks, slice(first, last)), y[i : i + 1])[0] for i, (first, last) in enumerate(pairwise(ends))
    ]
    terms = np.array(log_given) - log_p
    return float(terms.mean()), float(terms.std(ddof=1) / np.sqrt(len(terms)))


def _predicted(study: Study, posterior: Posterior, x: FloatArray, candidate: Candidate) -> Reading:
    return readings_of(Situation(study, posterior, x, "prior"), candidate)[0]


def _part(reading: Reading, rows: slice) -> Reading:
    return Reading(reading.mean[rows], reading.whitening[rows], reading.noise)


def _log_mean(reading: Reading, y: FloatArray) -> FloatArray:
    """Log of the mean density (m,) of readings (m, k) over draws."""
    blocks = [reading.log_density(y[start : start + 100]) for start in range(0, len(y), 100)]
    return np.asarray(np.concatenate([logsumexp(block, axis=1) for block in blocks]) - np.log(len(reading.mean)))


def _given(posterior: Posterior, values: FloatArray, columns: list[int], n: int, rng: Generator) -> FloatArray:
    """Draws of the cut prior given some parameters: fresh values of the others, kept inside the support."""
    x = posterior.prior.sample(n, rng)
    x[:, columns] = values
    kept = x[posterior.reasons(x) == INSIDE]
    return kept if len(kept) else x[:1]
