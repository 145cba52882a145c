"""One way to judge all trials: what stands after a fault, how a repetition ends, and with what."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from trials import CLEAR, RIGHT, Process, content, emptied, everything, sums_hold

INTERRUPTED = 130
"""Exit code after a signal that leaves time to put things down."""


def nothing(folder: Path) -> None:
    """Prepare nothing."""


@dataclass(frozen=True)
class Saving:
    """Something that is saved below a folder.

    Attributes
    ----------
    prepare : makes the folder as it is before.
    save : does the work and saves; its exit code.
    again : after a fault, goes on with what was left; by default the same as ``save``.
    stays : whether a whole folder ``out`` was there before, and must be there at any time.
    kept : what is still there of what was saved before the fault, or None where it is needed no more; the
        whole entry is None where nothing is saved before all is.
    interrupted : work whose folder ``out`` is also a right one after an interruption, because it puts down
        what it has.
    out : whether a folder ``out`` is what comes of it.
    code : exit code of an undisturbed one.
    """

    prepare: Callable[[Path], None]
    save: Callable[[Path], int]
    again: Callable[[Path], int] | None = None
    stays: bool = False
    kept: Callable[[Path], set[str] | None] | None = None
    interrupted: tuple[Callable[[Path], int], ...] = ()
    out: bool = True
    code: int = 0


@dataclass(frozen=True)
class Bench:
    """Where the trials of one saving are made: its place, and contents of ``out`` before and after."""

    saving: Saving
    place: Path
    notes: Path
    before: dict[str, str]
    after: dict[str, str]
    all_saved: set[str]
    partly: list[dict[str, str]]

    @classmethod
    def of(cls, saving: Saving, work: Path, place: Path | None = None) -> Bench:
        """Save without a fault."""
        place, notes = place or work / "trial", work / "notes"
        partly = [_outcome_of(one, saving, place, notes) for one in saving.interrupted]
        with emptied(place):
            saving.prepare(place)
            before = content(place / "out") if saving.stays else {}
            process = Process.begun(lambda: saving.save(place), notes)
            assert process.code() == saving.code, (process.code(), process.error)
            process.import_the_same()
            after = content(place / "out") if saving.out else {}
            return cls(saving, place, notes, before, after, set(process.saved), partly)

    def fresh(self) -> None:
        """Prepare the place, which is empty."""
        self.saving.prepare(self.place)

    def begun(self, before: Callable[[], None] = lambda: None) -> Process:
        """Begin to save."""
        return Process.begun(lambda: self.saving.save(self.place), self.notes, before)

    def begun_again(self) -> Process:
        """Go on, without a fault."""
        again = self.saving.again or self.saving.save
        return Process.begun(lambda: again(self.place), self.notes.with_name("notes-again"))

    def judged(self, process: Process, *, killed: bool, removed: frozenset[str] = frozenset()) -> tuple[str, str]:
        """Outcome and detail of a trial whose process has met its fault: look, repeat, look again.

        ``removed`` is what someone has taken away on purpose after it was saved.
        """
        code, saved = process.code(), set(process.saved) - removed
        said = "" if code == self.saving.code else "killed" if killed and code < 0 else process.error
        if said not in ("", "killed") and (code not in (2, 130) or said.startswith("not one line")):
            return "no clear error", f"{code} {said}"
        if left := process.orphans():
            return "orphans", f"{len(left)} processes"
        if problem := self.state(interrupted=code == INTERRUPTED):
            return problem
        problem = self.lost(saved) or self.ended(saved)
        return problem or (CLEAR if said not in ("", "killed") else RIGHT, said)

    def state(self, *, interrupted: bool = False) -> tuple[str, str] | None:
        """What is wrong just after the fault."""
        out, right = self.place / "out", [self.before, self.after, *(self.partly if interrupted else ())]
        if not out.exists():
            return ("lost", "the old folder is gone") if self.saving.stays else None
        if content(out) not in right or not sums_hold(out):
            return "half", "the folder is neither the old one nor the new one"
        return None

    def lost(self, saved: set[str]) -> tuple[str, str] | None:
        """What a process was told is saved, and is not there."""
        kept = self.saving.kept(self.place) if self.saving.kept else None
        lost = saved - kept if kept is not None else set()
        return ("lost", " ".join(sorted(lost))) if lost else None

    def ended(self, saved: set[str]) -> tuple[str, str] | None:
        """What is wrong with the repetition."""
        before = everything(self.place)
        process = self.begun_again()
        code = process.code()
        stood = code == 2 and "exists already" in process.error
        if code != self.saving.code and not stood:
            return "not to be repeated", process.error
        if self.saving.kept and (twice := saved & set(process.saved)):
            return "done again", " ".join(sorted(twice))
        if not self.saving.out:
            kept = self.saving.kept(self.place) if self.saving.kept else None
            return None if kept == self.all_saved else ("wrong", f"not all {len(self.all_saved)} are there")
        if content(self.place / "out") != self.after or not sums_hold(self.place / "out"):
            return "wrong", "the result is not that of an undisturbed one"
        if stood:  # a refusal leaves also what a kill in the last moment left: the next run clears it
            changed = everything(self.place) != before
            return ("lost", "a refusal has changed something") if changed else None
        remains = {path.name for path in self.place.iterdir()} - {"out"}
        remains |= {path.name for path in (self.place / "out").iterdir()} & {"checkpoint", "status.json"}
        return ("remains", " ".join(sorted(remains))) if remains else None


def _outcome_of(work: Callable[[Path], int], saving: Saving, place: Path, notes: Path) -> dict[str, str]:
    """Content of the folder that undisturbed work leaves."""
    with emptied(place):
        saving.prepare(place)
        process = Process.begun(lambda: work(place), notes)
        assert process.code() == saving.code, (process.code(), process.error)
        return content(place / "out")
