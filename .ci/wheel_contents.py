"""The wheel named holds every file of the package under version control, and no other."""

import subprocess
import sys
import zipfile
from pathlib import Path, PurePosixPath


def kept() -> set[str]:
    """Files under version control by their path when installed; a link to a folder is none."""
    command = ["git", "ls-files", "bayesterra", "models"]
    listed = subprocess.run(command, check=True, capture_output=True, text=True).stdout.split()
    files = [name for name in listed if not Path(name).is_symlink()]
    return {f"bayesterra/{name}" if name.startswith("models/") else name for name in files}


def packed(wheel: str) -> set[str]:
    """Files of a wheel beside its metadata."""
    names = {name for name in zipfile.ZipFile(wheel).namelist() if not name.endswith("/")}
    return {name for name in names if not PurePosixPath(name).parts[0].endswith(".dist-info")}


if __name__ == "__main__":
    missing, strange = kept() - packed(sys.argv[1]), packed(sys.argv[1]) - kept()
    if missing or strange:
        sys.exit(f"the wheel lacks {sorted(missing)} and has, besides, {sorted(strange)}")
