# SPDX-License-Identifier: GPL-3.0-or-later
"""Files that hold code, and whether anybody else could have written them.

Whoever may write a file that is run here, or put another in its place, has this process do what he likes. So such files
are read only from where nobody but this user and root can do either: the file itself, its folder and all folders and
links on the way there are looked at. A file is looked at after it was opened, so that it is the very one that is read.

Windows has rights of another kind; there nothing is looked at, and folders of a user's profile are his alone.
"""

from __future__ import annotations

import contextlib
import errno
import os
import stat
import uuid
from collections.abc import Iterator
from functools import cache
from pathlib import Path

from engine.runtime.plain_files import open_at_once

try:
    import grp
    import pwd
except ImportError:  # Windows
    grp = pwd = None  # type: ignore[assignment]

#: Links on the way to a file.
_MOST_LINKS = 40


def weakness(folder: Path) -> str:
    """Why somebody else could change what lies in a folder, in words; '' if nobody could.

    Raises
    ------
    OSError
        If there is no such folder.
    """
    if os.name == "nt":
        return ""
    way = list(_way_to(folder))
    for number, (path, info) in enumerate(way, 1):
        problem = _problem(info, is_sticky_enough=number < len(way))
        if problem:
            return f"{path} {problem}"
    return ""


def make_folder(folder: Path) -> None:
    """Make a folder and those above it, if they are missing, where only this user may write whatever the umask."""
    for missing in reversed([one for one in (folder, *folder.parents) if not one.exists()]):
        with contextlib.suppress(FileExistsError):
            missing.mkdir(mode=0o755)
    if not folder.is_dir():
        raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR), str(folder))


def read_trusted(path: Path) -> bytes | None:
    """What a file holds; None if there is none, or somebody else may have written it.

    Its folder is looked at too, but not those above: `weakness` does, once for all files below.

    Raises
    ------
    OSError
        If it cannot be read.
    """
    try:
        with open(path, "rb", opener=open_at_once) as file:
            info = os.fstat(file.fileno())
            if not stat.S_ISREG(info.st_mode):
                return None
            if os.name != "nt" and any(_problem(one, is_sticky_enough=False) for one in (info, path.parent.stat())):
                return None
            return file.read()
    except FileNotFoundError:
        return None


def write_trusted(path: Path, data: bytes) -> None:
    """Write a file that only this user may write whatever the umask; it is there whole, or not at all.

    Raises
    ------
    OSError
        If it cannot be written.
    """
    unfinished = path.with_name(f"{path.name}.tmp.{uuid.uuid4().hex[:16]}")
    try:
        with open(unfinished, "xb", opener=lambda name, flags: os.open(name, flags, 0o644)) as file:
            file.write(data)
        os.replace(unfinished, path)
    except BaseException:
        with contextlib.suppress(OSError):
            os.unlink(unfinished)
        raise


def _way_to(path: Path) -> Iterator[tuple[Path, os.stat_result]]:
    """All folders and links that are passed on the way to a path; what it leads to comes last."""
    path = Path(os.path.abspath(path))
    at, left, link_count = Path(path.anchor), list(reversed(path.parts[1:])), 0
    yield at, os.lstat(at)
    while left:
        name = left.pop()
        if name == "..":
            at = at.parent
            continue
        at /= name
        info = os.lstat(at)
        yield at, info
        if stat.S_ISLNK(info.st_mode):
            link_count += 1
            if link_count > _MOST_LINKS:
                raise OSError(errno.ELOOP, os.strerror(errno.ELOOP), str(path))
            target = Path(os.readlink(at))
            at = Path(target.anchor) if target.is_absolute() else at.parent
            left.extend(reversed(target.parts[1:] if target.is_absolute() else target.parts))


def _problem(info: os.stat_result, *, is_sticky_enough: bool) -> str:
    """What is wrong with who may write a file or folder; '' if nothing is.

    is_sticky_enough : bool, whether others may add to it what only they may change, as in a folder for all's temporary
        files: what lies further on is looked at too
    """
    if info.st_uid not in _trusted_users():
        return "belongs to another user"
    is_link = stat.S_ISLNK(info.st_mode)
    if is_link or (is_sticky_enough and info.st_mode & stat.S_ISVTX):
        return ""
    by_group = info.st_mode & stat.S_IWGRP and not _is_own_group(info.st_gid)
    return "can be written by others" if by_group or info.st_mode & stat.S_IWOTH else ""


@cache
def _trusted_users() -> frozenset[int]:
    """This user and root; in a container also what root is called there whom it does not know."""
    trusted = {0, os.geteuid()}
    with contextlib.suppress(OSError, ValueError):
        unknown = int(Path("/proc/sys/kernel/overflowuid").read_text("ascii"))
        ranges = [line.split() for line in Path("/proc/self/uid_map").read_text("ascii").splitlines()]
        if not any(int(first) <= unknown < int(first) + int(count) for first, _outside, count in ranges):
            trusted.add(unknown)
    return frozenset(trusted)


@cache
def _is_own_group(group: int) -> bool:
    """Whether this user has a group of his own, as many systems make it, and this is it. Nobody else is in it."""
    user = os.geteuid()
    if user == 0:
        return False
    try:
        entry, members = pwd.getpwuid(user), grp.getgrgid(group)
    except KeyError:
        return False
    is_namesake = members.gr_name == entry.pw_name and entry.pw_gid == group
    return is_namesake and set(members.gr_mem) <= {entry.pw_name}
