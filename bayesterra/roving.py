"""A rover driven with the draws of a finished result, written as a folder."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, fields
from importlib.metadata import version
from pathlib import Path
from typing import Self

from bayesterra.csvfiles import csv_text
from bayesterra.errors import StudyError
from bayesterra.figures.rover import rover_outlook_png
from bayesterra.folders import check_free, whole_folder, write_bytes, write_text
from bayesterra.messages import check_kind, checked_path
from bayesterra.prediction import UNANSWERED
from bayesterra.results import Result
from bayesterra.rover.driving import SLOPES, drive_rover, rover_for
from bayesterra.rover.geometry import Rover
from bayesterra.rover.outlook import DEGREE, RoverOutlook

ROVER = "rover.json"
"""File by which a folder of this kind is known."""


class RoverSheet(RoverOutlook):
    """What draws say about a rover, to be saved as a folder with its plot."""

    @classmethod
    def of(cls, outlook: RoverOutlook) -> Self:
        """The same outlook, with files to write."""
        return cls(**{field.name: getattr(outlook, field.name) for field in fields(RoverOutlook)})

    def save(self, folder: str | Path, *, overwrite: bool = False) -> Path:
        """Write bands, draws, greatest slopes, a plot and a record into a new folder; returns its path.

        Raises
        ------
        ResultError : the folder exists (and ``overwrite`` is not given) or cannot be written.
        """
        check_free(Path(folder), overwrite=overwrite, mark=ROVER)
        with whole_folder(Path(folder), overwrite=overwrite, mark=ROVER) as part:
            write_text(part / "bands.csv", csv_text(self.table))
            write_text(part / "draws.csv", csv_text(self.to_dataframe()))
            write_text(part / "greatest.csv", csv_text(self.greatest_table))
            write_text(part / "climb.csv", csv_text(self.climb_table))
            write_bytes(part / "rover.png", rover_outlook_png(self))
            write_text(part / ROVER, json.dumps(self._record(), indent=1, ensure_ascii=False) + "\n")
        return Path(folder)

    def _record(self) -> dict[str, object]:
        return {
            "kind": "rover",
            "title": self.title,
            "model": self.model,
            "bayesterra": version("bayesterra"),
            "rover": asdict(self.rover),
            "slope": self.asked.slope[0].tolist(),
            "tow": self.asked.tow[0].tolist(),
            "draws": len(self.index),
            "share_that_cannot": self.cannot.tolist(),
            "share_without_answer": self.unanswered.tolist(),
            "marked_above": UNANSWERED,
            "notes": list(self.notes),
        }

    def _repr_html_(self) -> str:
        return str(self.table.to_html(index=False, float_format=lambda value: f"{value:.4g}"))


def predict_rover(
    result: Result,
    rover: Rover | str | Path,
    *,
    slopes: Sequence[float | str] = SLOPES,
    tows: Sequence[float | str] = (0.0,),
) -> RoverSheet:
    """Drive a rover up slopes and against tow forces on the soil of every posterior draw.

    Parameters
    ----------
    rover : a :class:`Rover`, or a file of one.
    slopes : rad, or text with a unit, from 0 to 45 degrees.
    tows : forces that pull back along the slope, N or text with a unit; every slope is tried with each.

    Raises
    ------
    StudyError : a file that describes no rover, or a slope or tow force outside its range.
    """
    check_kind("bt.predict_rover", result, Result)
    if not isinstance(rover, Rover):
        rover = checked_path("bt.predict_rover", rover, "a rover file, or a bt.Rover")
    return RoverSheet.of(drive_rover(result, rover_for(result.study, rover), slopes, tows))


def slopes_of(texts: Sequence[str]) -> tuple[float | str, ...]:
    """Slopes from texts such as ``0,5,10``, degrees where no unit is given; the default where there are none.

    Raises
    ------
    StudyError : one is not a number.
    """
    found: list[float | str] = []
    for part in (part.strip() for text in texts for part in text.split(",")):
        try:
            found.append(float(part) * DEGREE)
        except ValueError:
            if not part[:1].isdigit():
                raise StudyError(f"'slope' must be degrees with commas, e.g. 0,5,10 (got {part!r})") from None
            found.append(part)
    return tuple(found) or SLOPES


def tows_of(texts: Sequence[str]) -> tuple[float | str, ...]:
    """Tow forces from texts such as ``0 N,35 N``; none where there are none."""
    return tuple(part.strip() for text in texts for part in text.split(",")) or (0.0,)
