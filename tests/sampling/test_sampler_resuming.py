"""A sampler that is stopped after any of its notes goes on to the same draws."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from numpy.random import SeedSequence
from numpy.typing import NDArray

from bayesterra.errors import ResultError
from bayesterra.likelihood.posterior import Posterior, posterior
from bayesterra.runtime.checkpoints import CheckpointStore, Segment, pack, unpack
from bayesterra.sampling import sampler
from bayesterra.sampling.adaptation import AdaptationOptions
from bayesterra.sampling.ensemble import Ensemble, EnsembleState
from bayesterra.sampling.sampler import Progress, Samples, sample
from bayesterra.study.schema import SamplingOptions
from bayesterra.study.study import Study

MakeStudy = Callable[..., Study]

OPTIONS = SamplingOptions(target_ess=100_000, walkers=32, max_steps=50)
PLAN = AdaptationOptions(particles=128, components=2, sweeps=1, refinements=(2,), more=(), shores=2, climbs=10)
NOTES = [*(f"ensemble-{i}" for i in range(1, 5)), "round-0001", "round-0002", "round-0003"]


class Stop(BaseException):
    """The end of a process."""


class Memory(CheckpointStore):
    """A journal in memory, which ends the process after so many notes."""

    def __init__(self, notes: Mapping[str, Segment] = {}, *, most: int = 1000) -> None:
        self.notes, self.most = dict(notes), most

    def holds(self, name: str) -> bool:
        """See ``CheckpointStore``."""
        return name in self.notes

    def load(self, name: str) -> Segment | None:
        """See ``CheckpointStore``."""
        return self.notes.get(name)

    def save(self, name: str, segment: Segment) -> None:
        """See ``CheckpointStore``."""
        if len(self.notes) >= self.most:
            raise Stop
        self.notes[name] = segment


@pytest.fixture(scope="module", autouse=True)
def short_rounds() -> Iterator[None]:
    """Three rounds, the last one shorter."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sampler, "ROUND_STEPS", 20)
        yield


@pytest.fixture(scope="module")
def density(make_study: MakeStudy) -> Posterior:
    """Two free parameters of an M2 study."""
    return posterior(make_study(free=("c", "phi")))


def sampled(density: Posterior, checkpoint_store: Memory | None, **options: Any) -> Samples:
    """A short run."""
    return sample(density, OPTIONS, SeedSequence(7), adaptation=PLAN, checkpoint_store=checkpoint_store, **options)


@pytest.fixture(scope="module")
def noted(density: Posterior) -> tuple[Samples, Mapping[str, Segment]]:
    """What an undisturbed run finds, and all that it notes in its order."""
    journal = Memory()
    return sampled(density, journal), journal.notes


def assert_same(one: Samples, other: Samples) -> None:
    """All that goes into a result is the same bit for bit."""
    np.testing.assert_array_equal(one.chains, other.chains)
    np.testing.assert_array_equal(one.acceptance, other.acceptance)
    for mine, theirs in zip(one.adaptations, other.adaptations, strict=True):
        packed, again = pack(mine), pack(theirs)
        assert packed.keys() == again.keys()
        for name, array in packed.items():
            np.testing.assert_array_equal(array, again[name])


@pytest.mark.slow
def test_a_sampler_stopped_after_any_note_ends_with_the_same_draws(density: Posterior) -> None:
    """Whatever was noted, from nothing to everything, the draws are those of a run without a journal."""
    undisturbed = sampled(density, None)
    whole = Memory()
    assert_same(sampled(density, whole), undisturbed)
    assert sorted(whole.notes) == NOTES
    for most in range(len(NOTES)):
        first = Memory(most=most)
        with pytest.raises(Stop, match=r"^$"):
            sampled(density, first)
        assert len(first.notes) == most
        assert_same(sampled(density, Memory(first.notes)), undisturbed)


def test_rounds_of_another_length_are_gone_on_with(density: Posterior, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rounds that were saved when they were longer count as many steps as they have."""
    monkeypatch.setattr(sampler, "ROUND_STEPS", 30)
    first = Memory(most=len(NOTES) - 2)
    with pytest.raises(Stop, match=r"^$"):
        sampled(density, first)
    assert "round-0001" in first.notes
    monkeypatch.setattr(sampler, "ROUND_STEPS", 20)
    found = sampled(density, Memory(first.notes))
    assert found.chains.shape[1] == found.diagnosis.steps == OPTIONS.max_steps


@pytest.mark.parametrize("lost", ["ensemble-2", "round-0001", "round-0002", "round-0003"])
def test_a_lost_note_is_made_again(lost: str, density: Posterior, noted: tuple[Samples, Mapping[str, Segment]]) -> None:
    """A note that is missing among later ones is made anew, to the same draws."""
    undisturbed, notes = noted
    rest = Memory({name: segment for name, segment in notes.items() if name != lost})
    assert_same(sampled(density, rest), undisturbed)
    assert sorted(rest.notes) == NOTES


def test_what_is_noted_is_not_done_again(
    density: Posterior, noted: tuple[Samples, Mapping[str, Segment]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """With all notes at hand no step is taken, the diagnosis is made once, and the earlier time counts."""
    reports = list[Progress]()
    before, notes = noted

    def forbidden(*_: Any) -> Any:
        raise AssertionError("done again")

    monkeypatch.setattr(Ensemble, "segment", forbidden)
    monkeypatch.setattr(sampler, "adapt", forbidden)
    after = sampled(density, Memory(notes), report=reports.append)
    assert [r.stage for r in reports] == ["adapting", "sampling"]
    assert after.diagnosis.checks == before.diagnosis.checks
    assert before.earlier == 0.0
    assert after.seconds["adaptation"] == before.seconds["adaptation"]
    assert after.seconds["production"] + after.seconds["adaptation"] >= after.earlier > 0.0


def test_a_run_that_converged_stops_where_it_did(density: Posterior) -> None:
    """The last round of a converged run is known for the last when it is resumed."""
    options = SamplingOptions(target_ess=1000, walkers=32, max_steps=5000)
    whole = Memory()
    first = sample(density, options, SeedSequence(7), adaptation=PLAN, checkpoint_store=whole)
    assert first.diagnosis.converged
    for most in (len(whole.notes) - 1, len(whole.notes)):
        part = Memory(dict(list(whole.notes.items())[:most]))
        assert_same(sample(density, options, SeedSequence(7), adaptation=PLAN, checkpoint_store=part), first)
        assert len(part.notes) == len(whole.notes)


@pytest.mark.parametrize("most", [1, 5])
def test_saved_draws_of_another_density_are_refused(
    most: int, noted: tuple[Samples, Mapping[str, Segment]], make_study: MakeStudy
) -> None:
    """Where walkers have another log density than was saved with them, nothing goes on."""
    first = dict(list(noted[1].items())[:most])
    other = posterior(make_study(free=("c", "phi"), noise={"drawbar_pull": 1.5000001}))
    with pytest.raises(ResultError, match=r"their log density is off by \de-\d+ of itself"):
        sampled(other, Memory(first))


def test_the_state_of_the_generator_is_whole() -> None:
    """The generator of emcee continues its stream, with the normal draw that it had left over."""
    random = np.random.RandomState(3)
    random.standard_normal(3)
    u, level = np.ones((4, 2)), np.zeros(4)
    state = EnsembleState(u, level, *random.get_state()[1:])  # type: ignore[index]
    assert state.has_gauss
    back = unpack(EnsembleState, pack(state))
    other = np.random.RandomState(1)
    other.set_state(back.state().random_state)
    np.testing.assert_array_equal(other.standard_normal(5), random.standard_normal(5))


@dataclass(frozen=True)
class Inner:
    """An array and two numbers."""

    array: NDArray[np.float64]
    count: int
    value: float


@dataclass(frozen=True)
class Outer:
    """Every kind of thing that can be noted."""

    inner: Inner
    several: tuple[Inner, ...]
    arrays: tuple[NDArray[np.float64], ...]
    numbers: tuple[float, ...]
    nothing: Inner | None
    something: float | None
    flag: bool


def test_values_come_back_as_they_were_noted() -> None:
    """Dataclasses, tuples, numbers, arrays and None survive, NaN and the last digit included."""
    inner = Inner(np.array([[0.1, np.nan], [np.inf, -0.0]]), 3, 1 / 3)
    for several in ((), (inner, inner)):
        value = Outer(inner, several, (np.arange(2.0), np.zeros(0)), (0.1, 0.2), None, 0.7, True)
        back = unpack(Outer, pack(value))
        assert repr(back) == repr(value)
        assert type(back.inner.count) is int
        assert type(back.numbers[0]) is float
    with pytest.raises(TypeError, match=r"'inner\.value' cannot be saved \(got object\)"):
        pack(Outer(Inner(np.ones(1), 1, object()), (), (), (), None, None, False))  # type: ignore[arg-type]
