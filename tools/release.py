# SPDX-License-Identifier: GPL-3.0-or-later
"""What a release is checked by: `.github/workflows/release.yml` runs these commands, and so can anybody.

- `python tools/release.py check v0.1.0`: the tag is the version that the manifest, CITATION.cff and CHANGELOG.md have.
- `python tools/release.py checksums dist`: there is a zip for each range of Blenders and platform; writes SHA256SUMS.
- `python tools/release.py notes`: prints the version's part of CHANGELOG.md.
"""

from __future__ import annotations

import argparse
import hashlib
import re
import sys
import tomllib
from collections.abc import Sequence
from pathlib import Path

if __package__:
    from .blender_ranges import RANGES, ROOT
    from .build_extension import PLATFORMS
else:
    from blender_ranges import RANGES, ROOT
    from build_extension import PLATFORMS

#: As `sha256sum` reads it.
CHECKSUMS = "SHA256SUMS"


def manifest_version() -> str:
    """The version that Blender sees."""
    return str(tomllib.loads((ROOT / "blender_manifest.toml").read_text("utf-8"))["version"])


def notes(changelog: str, version: str) -> str:
    """A version's part of the changelog, '' where there is none."""
    part = rf"^## {re.escape(version)}(?:[ \t][^\n]*)?\n(.*?)(?=^## |\Z)"
    found = re.search(part, changelog, re.MULTILINE | re.DOTALL)
    return found.group(1).strip() if found else ""


def check_tag(tag: str) -> None:
    """Raise where a tag is not of the version that is released.

    Raises
    ------
    ValueError
        Naming the file that says something else.
    """
    version = manifest_version()
    if tag != f"v{version}":
        raise ValueError(f"the tag is {tag}, and blender_manifest.toml has the version {version}: tag v{version}")
    cited = re.search(r"^version: (\S+)$", (ROOT / "CITATION.cff").read_text("utf-8"), re.MULTILINE)
    if cited is None or cited.group(1) != version:
        raise ValueError(f"CITATION.cff has another version than {version}")
    if not notes((ROOT / "CHANGELOG.md").read_text("utf-8"), version):
        raise ValueError(f"CHANGELOG.md says nothing of {version}")


def expected_zips(version: str) -> list[str]:
    """Names of all zips of a release."""
    return sorted(
        f"neuralguide-{version}-{blenders.name}-{platform}.zip" for blenders in RANGES for platform in PLATFORMS
    )


def write_checksums(folder: Path, version: str) -> Path:
    """Write the checksums of a whole set of zips.

    Raises
    ------
    ValueError
        Naming the zips that are missing, or belong to another version.
    """
    expected, found = expected_zips(version), sorted(path.name for path in folder.glob("*.zip"))
    missing, others = sorted(set(expected) - set(found)), sorted(set(found) - set(expected))
    if missing:
        raise ValueError(f"{folder} lacks {', '.join(missing)}")
    if others:
        raise ValueError(f"{folder} has zips that are not of {version}: {', '.join(others)}")
    lines = [f"{hashlib.sha256((folder / name).read_bytes()).hexdigest()}  {name}\n" for name in expected]
    file = folder / CHECKSUMS
    file.write_text("".join(lines), encoding="ascii")
    return file


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    commands = parser.add_subparsers(dest="command", required=True)
    commands.add_parser("check", help="whether a tag is of this version").add_argument("tag")
    commands.add_parser("checksums", help="write SHA256SUMS").add_argument("folder", type=Path)
    commands.add_parser("notes", help="print what has changed")
    options = parser.parse_args(arguments)
    try:
        if options.command == "check":
            check_tag(options.tag)
        elif options.command == "checksums":
            print(write_checksums(options.folder, manifest_version()))
        else:
            print(notes((ROOT / "CHANGELOG.md").read_text("utf-8"), manifest_version()))
    except ValueError as error:
        print(f"release: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
