"""Compiled functions on disk: of use, or out of the way.

numba's own cache ends a program where no folder can be written, where an entry is damaged and where the disk
is full. Here an entry is one file, with a digest of itself and of everything that it depends on. What is not
whole is compiled again, what cannot be written is not kept, and neither changes a number.
"""

import logging
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache, cached_property
from hashlib import sha256
from multiprocessing import parent_process
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any
from uuid import uuid4

import numba
from numba.core import caching, compiler, config, serialize

_LOCATORS: Any = caching  # numba has no types
_CONFIG: Any = config
_COMPILED: Any = compiler.CompileResult
_PACKING: Any = serialize
_DIGEST = sha256().digest_size
_told: list[str] = []
"""Reason why nothing can be kept, once that was told."""
_watching: list[Callable[[str], None]] = []
"""Who is told of what is being compiled."""


@contextmanager
def told_of_compiling(tell: Callable[[str], None]) -> Iterator[None]:
    """Call ``tell`` with the name of every function that is compiled meanwhile, before it is."""
    _watching.append(tell)
    try:
        yield
    finally:
        _watching.remove(tell)


class CompiledFiles:
    """Compiled versions of a function on disk, with the methods by which a dispatcher of numba asks for them.

    They stand where numba would keep them: in the folder that NUMBA_CACHE_DIR names, else beside the sources,
    else in the user's cache. Folders before the first one that can be written are read all the same.

    Parameters
    ----------
    function : a function of a module, without variables of a function around it.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        self._source = Path(function.__code__.co_filename)
        self._function = function

    @cached_property
    def _folders(self) -> list[Path]:
        """Folders to read, the one to write last; where none can be written, all of them."""
        kinds = ["InTreeCacheLocator", "UserWideCacheLocator"]
        if _CONFIG.CACHE_DIR:
            kinds.insert(0, "UserProvidedCacheLocator")
        found: list[Path] = []
        for kind in kinds:
            locator = getattr(_LOCATORS, kind, None) or getattr(_LOCATORS, f"_{kind}")  # numba up to 0.61
            found.append(Path(locator(self._function, str(self._source)).get_cache_path()))
            if _writable(found[-1]):
                break
        return found

    @property
    def cache_path(self) -> str:
        """The folder that is written."""
        return str(self._folders[-1])

    def load_overload(self, signature: Any, context: Any) -> Any:
        """Compiled version for types of arguments; None where there is none that is whole and of today."""
        context.refresh()
        name, stamp = self._entry(signature, context.codegen())
        for folder in self._folders:
            with suppress(Exception):  # whatever is wrong with an entry, compiling again is right
                content = (folder / name).read_bytes()
                if content[:_DIGEST] == sha256(stamp + content[_DIGEST:]).digest():
                    return _COMPILED._rebuild(context, *_PACKING.loads(content[_DIGEST:]))
        for tell in tuple(_watching):
            tell(self._function.__name__)
        return None

    def save_overload(self, signature: Any, made: Any) -> None:
        """Keep a compiled version; where that cannot be, say so once."""
        if made.library.has_dynamic_globals:  # addresses of this process
            return
        if not _writable(self._folders[-1]):
            _tell(f"no write access to {' or '.join(map(str, self._folders))}")
            return
        name, stamp = self._entry(signature, made.codegen)
        content = _PACKING.dumps(made._reduce())
        try:
            _write(self._folders[-1] / name, sha256(stamp + content).digest() + content)
        except OSError as error:
            _tell(f"{error.strerror}: {self._folders[-1] / name}")

    def _entry(self, signature: Any, codegen: Any) -> tuple[str, bytes]:
        """File name for types of arguments on this processor, and all that its content depends on."""
        kind = repr((signature, codegen.magic_tuple()))
        called = f"{self._source.stem}.{self._function.__qualname__}".replace("<", "").replace(">", "")
        name = f"{called}.{sys.implementation.cache_tag}-{sha256(kind.encode()).hexdigest()[:16]}.nbc"
        return name, repr((numba.__version__, called, kind, _fingerprint(self._source))).encode()


@cache
def _fingerprint(source: Path) -> str:
    """Digest of the sources of the models' kernels, of those beside a source, and of the source."""
    digest = sha256()
    folders = (Path(__file__).parent, source.parent)
    for part in (*(part for folder in folders for part in sorted(folder.glob("*.py"))), source):
        digest.update(part.read_bytes())
    return digest.hexdigest()


@cache
def _writable(folder: Path) -> bool:
    """True where files can be made in a folder, which is made where it is missing."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        TemporaryFile(dir=folder).close()
    except OSError:
        return False
    return True


def _write(path: Path, content: bytes) -> None:
    """Write a file that others see whole or not at all."""
    temporary = path.with_name(f"{path.name}.tmp.{uuid4().hex[:16]}")
    try:
        with temporary.open("xb") as file:
            file.write(content)
        os.replace(temporary, path)
    except BaseException:
        with suppress(OSError):
            temporary.unlink()
        raise


def _tell(reason: str) -> None:
    """Tell once that every start will compile; workers leave it to the process that started them."""
    if not _told and parent_process() is None:
        logging.getLogger("bayesterra").warning(
            "note: compiled models cannot be kept (%s), so every start compiles them again, which takes about"
            " half a minute; NUMBA_CACHE_DIR may name a folder that can be written",
            reason,
        )
    _told.append(reason)
