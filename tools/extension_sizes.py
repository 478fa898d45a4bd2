# SPDX-License-Identifier: GPL-3.0-or-later
"""`python -m tools.extension_sizes dist/*.zip` prints the size of each zip, and what it takes up once installed."""

from __future__ import annotations

import argparse
import io
import zipfile
from pathlib import Path
from typing import NamedTuple

_MIB = 2**20


class ExtensionSize(NamedTuple):
    """Bytes of an extension.

    download : int, the zip
    folder : int, the extension's own folder, in which Blender keeps the wheels as they are
    packages : int, what Blender unpacks from the wheels
    """

    download: int
    folder: int
    packages: int

    @property
    def installed(self) -> int:
        """Bytes on the user's disk, before any kernel is compiled."""
        return self.folder + self.packages


def measure(path: Path) -> ExtensionSize:
    """Sizes of the extension in a zip that `tools/build_extension.py` made."""
    folder = packages = 0
    with zipfile.ZipFile(path) as archive:
        for item in archive.infolist():
            folder += item.file_size
            if item.filename.endswith(".whl"):
                with zipfile.ZipFile(io.BytesIO(archive.read(item))) as wheel:
                    packages += sum(part.file_size for part in wheel.infolist())
    return ExtensionSize(path.stat().st_size, folder, packages)


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("zips", nargs="+", type=Path)
    print("| zip | download [MiB] | unpacked packages [MiB] | installed [MiB] |\n|---|---|---|---|")
    for path in parser.parse_args().zips:
        size = measure(path)
        figures = (size.download, size.packages, size.installed)
        print(f"| {path.name} | " + " | ".join(f"{figure / _MIB:.0f}" for figure in figures) + " |")


if __name__ == "__main__":
    main()
