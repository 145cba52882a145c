"""Records: the JSON files of folders, with a format number; written, read and checked by their models."""

from __future__ import annotations

import json
import math
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError, create_model

from bayesterra.errors import ResultError
from bayesterra.runtime.folders import write_text
from bayesterra.runtime.reading import read_json

Number = Annotated[float, Field(gt=-1e300, lt=1e300, allow_inf_nan=False)]
Count = Annotated[int, Field(ge=0, lt=10**15)]
"""A whole number that some study reaches."""


class Record(BaseModel):
    """The content of a JSON file; entries that it does not name may be there, and stay as they are.

    Attributes
    ----------
    FORMAT : number of the form in which the file is written; one without a number has form 1.
    """

    model_config = ConfigDict(strict=True, extra="allow")
    FORMAT: ClassVar[int] = 1

    @classmethod
    def having(cls, **kinds: Any) -> type[Record]:
        """A model of records that have more entries, each of its kind."""
        entries: dict[str, Any] = {name: (kind, ...) for name, kind in kinds.items()}
        return create_model(cls.__name__, __base__=cls, **entries)

    @classmethod
    def write(cls, path: Path, content: Mapping[str, Any]) -> None:
        """Write a record, its format number first; NaN and infinities become null."""
        stamped = {"format": cls.FORMAT, **{k: v for k, v in content.items() if k != "format"}}
        write_text(path, json.dumps(plain(stamped), indent=1, ensure_ascii=False, allow_nan=False) + "\n")

    @classmethod
    def read(cls, path: Path) -> dict[str, Any]:
        """Content of a file that :meth:`write` wrote, or a version before there were format numbers.

        Raises
        ------
        OSError, ValueError : it cannot be read, or is no such record.
        ResultError : it has another format.
        """
        content = read_json(path)
        if isinstance(content, dict) and (number := content.get("format", 1)) != cls.FORMAT:
            raise ResultError(
                f"'{path}' has format {number!r:.40}, and this version of bayesterra reads format"
                f" {cls.FORMAT}: open it with the version that wrote it"
            )
        cls.check(content, path.name)
        return dict(content)

    @classmethod
    def check(cls, content: Any, name: str) -> None:
        """ValueError where something is missing, or of another kind than is relied on."""
        try:
            cls.model_validate(content)
        except ValidationError as error:
            for first in error.errors():
                *outer, last = (name, *map(str, first["loc"]))
                if first["type"] == "missing" and len(outer) == 1 and last in cls.excused(content):
                    continue
                if first["type"] == "missing":
                    raise ValueError(f"{': '.join(outer):.200} lacks '{last}'") from None
                reason = str(first.get("ctx", {}).get("error", "is of the wrong kind"))
                place = ": ".join((*outer, last))
                raise ValueError(f"{place:.200} {reason} (got {first['input']!r:.40})") from None

    @classmethod
    def excused(cls, content: dict[str, Any]) -> Collection[str]:
        """Entries that may be missing from a record, for a reason that it gives."""
        return ()


def plain(value: Any) -> Any:
    """A value that JSON can hold: NaN and infinities become null, NumPy numbers Python ones."""
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    value = value.item() if hasattr(value, "item") else value
    return None if isinstance(value, float) and not math.isfinite(value) else value
