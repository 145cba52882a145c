"""A joint posterior goes on from what was noted of it, and ends where it would have ended."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from numpy.random import SeedSequence

from bayesterra.errors import ResultError
from bayesterra.likelihood.joint import JointPosterior, joint_posterior
from bayesterra.runtime.checkpoints import CheckpointStore, Segment, pack, unpack
from bayesterra.sampling import joint as joint_sampling
from bayesterra.sampling.family import JointFamily
from bayesterra.sampling.joint import JointSamples, PoolingOptions, sample_joint
from bayesterra.sampling.moves import JointSegment, JointState, run_together
from bayesterra.study.schema import SamplingOptions
from bayesterra.study.study import Study

SHORT = SamplingOptions(target_ess=100_000, ensembles=4, walkers=32, max_steps=9)


class StoppedError(Exception):
    """The end of a process."""


@dataclass
class Notes(CheckpointStore):
    """A journal in memory, whose process ends at a save; segments that are asked for are noted."""

    segments: dict[str, Segment] = field(default_factory=dict)
    ends_at: str = ""
    made: list[str] = field(default_factory=list)

    def holds(self, name: str) -> bool:
        """See :class:`bayesterra.runtime.checkpoints.CheckpointStore`."""
        return name in self.segments

    def load(self, name: str) -> Segment | None:
        """See :class:`bayesterra.runtime.checkpoints.CheckpointStore`."""
        return self.segments.get(name)

    def save(self, name: str, segment: Segment) -> None:
        """See :class:`bayesterra.runtime.checkpoints.CheckpointStore`."""
        if name == self.ends_at:
            raise StoppedError
        self.segments[name] = segment
        self.made.append(name)


@pytest.fixture(scope="module")
def joint(make: Callable[..., Study]) -> JointPosterior:
    """Two wheels that share φ, K from a population."""
    return joint_posterior(make())


@pytest.fixture(scope="module", autouse=True)
def short_rounds() -> object:
    """Small laws, and rounds of some sweeps, with laws fitted anew after the second."""
    patch = pytest.MonkeyPatch()
    patch.setattr(joint_sampling, "ROUND_SWEEPS", 3)
    patch.setattr(joint_sampling, "PATIENCE", 6)
    patch.setattr(joint_sampling, "LONE_STEPS", 10)
    patch.setattr(joint_sampling, "FITTED", 256)
    patch.setattr(joint_sampling, "STARTS", 128)
    patch.setattr(joint_sampling, "FEWEST", 2)
    patch.setattr(joint_sampling, "MOST", 2)
    yield
    patch.undo()


def run(joint: JointPosterior, small: PoolingOptions, checkpoint_store: CheckpointStore | None = None) -> JointSamples:
    """A run that takes all its steps."""
    return sample_joint(
        joint, SHORT, SeedSequence(4), plan=replace(small, warm_ups=(3,)), checkpoint_store=checkpoint_store
    )


@pytest.fixture(scope="module")
def whole(joint: JointPosterior, small: PoolingOptions) -> tuple[JointSamples, Notes]:
    """What an undisturbed run finds and notes."""
    notes = Notes()
    return run(joint, small, notes), notes


def same(one: JointSamples, other: JointSamples) -> None:
    """Draws, accepted shares and the laws that evidence is weighed with are equal to the last bit."""
    np.testing.assert_array_equal(one.chains, other.chains)
    np.testing.assert_array_equal(one.acceptance, other.acceptance)
    assert one.moves == other.moves
    for first, second in zip(one.laws, other.laws, strict=True):
        np.testing.assert_array_equal(first.drivers.mixture.means, second.drivers.mixture.means)
        np.testing.assert_array_equal(first.locals[1].mixture.factors, second.locals[1].mixture.factors)


def test_notes_change_nothing(joint: JointPosterior, small: PoolingOptions, whole: tuple[JointSamples, Notes]) -> None:
    """Nor does reading them all."""
    found, notes = whole
    assert found.chains.shape[1] == 9
    rounds = [name for name in notes.segments if name.startswith("joint-round-")]
    assert len(rounds) == 5  # of which two were forgotten when the laws were fitted anew
    same(run(joint, small), found)
    made = list(notes.made)
    same(run(joint, small, notes), found)
    assert notes.made == made


def test_laws_of_a_run_that_is_nearly_done_stay(
    joint: JointPosterior, small: PoolingOptions, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No sweep is forgotten where as many more bring all that is asked for."""
    monkeypatch.setattr(joint_sampling, "NEARLY", 0.0)
    notes = Notes()
    assert run(joint, small, notes).chains.shape[1] == 9
    assert len([name for name in notes.segments if name.startswith("joint-round-")]) == 3


@pytest.mark.slow
@pytest.mark.parametrize("ends_at", ["joint-begun", "joint-round-0004"])
def test_a_run_that_ended_goes_on(
    ends_at: str, joint: JointPosterior, small: PoolingOptions, whole: tuple[JointSamples, Notes]
) -> None:
    """From every kind of segment, and makes none twice."""
    found, notes = whole
    before = Notes({n: s for n, s in notes.segments.items() if n.startswith("group-")}, ends_at)
    with pytest.raises(StoppedError):
        run(joint, small, before)
    after = Notes(before.segments)
    known = set(before.segments)
    same(run(joint, small, after), found)
    assert not known & set(after.made)
    assert set(after.segments) == set(notes.segments)


def test_an_ensemble_that_was_put_down_goes_on_like_one_that_was_not(
    joint: JointPosterior, whole: tuple[JointSamples, Notes]
) -> None:
    """Laws, walkers, generator and counts: the next sweeps are the same."""
    family = JointFamily(joint)
    ensemble = unpack(JointSegment, whole[1].segments["joint-begun"]).ends[0].ensemble(family)
    run_together([ensemble], 2)
    other = unpack(JointState, pack(JointState.of(ensemble))).ensemble(family)
    for one, same_ in zip(run_together([ensemble], 3), run_together([other], 3), strict=True):
        np.testing.assert_array_equal(one, same_)
    assert ensemble.counts == other.counts
    assert ensemble.rng.bit_generator.state == other.rng.bit_generator.state


def test_walkers_of_another_density_are_refused(
    joint: JointPosterior, small: PoolingOptions, whole: tuple[JointSamples, Notes]
) -> None:
    """As after a change of a library that changes numbers."""
    segments = dict(whole[1].segments)
    begun = dict(segments["joint-begun"])
    begun["ends.0.walkers.likelihood"] = begun["ends.0.walkers.likelihood"] + 1e-3
    with pytest.raises(ResultError, match="the saved draws cannot be used: their log density is off by"):
        run(joint, small, Notes({**segments, "joint-begun": begun}))
