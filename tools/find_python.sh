#!/bin/sh
# SPDX-License-Identifier: GPL-3.0-or-later
# Prints the path of a Python that runs: `tools/find_python.sh 3.11 3.13` for the first of these versions there is.
#
# Every candidate is run, not only looked up: a version manager puts names on the path that fail when called, and Debian
# has Pythons that cannot make environments until python3-venv is installed.
set -u

# Says whether $1 runs, is Python $2 and can make environments.
fits() {
    [ -x "$1" ] && "$1" -c "
import sys
import ensurepip, venv
sys.exit('%d.%d' % sys.version_info[:2] != '$2')
" >/dev/null 2>&1
}

# Prints where Python $1 may be, one path a line, best first.
candidates() {
    for name in "python$1" python3 python; do
        printf '%s\n' "$PATH" | tr ':' '\n' | sed "s|\$|/$name|"
    done
    root="${PYENV_ROOT:-${HOME:-}/.pyenv}"
    for path in "$root/versions/$1".*/bin/python; do
        printf '%s\n' "$path"
    done
}

if [ $# -eq 0 ]; then
    echo "usage: tools/find_python.sh VERSION..." >&2
    exit 2
fi

wanted=
for version in "$@"; do
    found=$(candidates "$version" | while IFS= read -r path; do
        if fits "$path" "$version"; then
            printf '%s\n' "$path"
            break
        fi
    done)
    if [ -n "$found" ]; then
        printf '%s\n' "$found"
        exit 0
    fi
    wanted="${wanted:+$wanted or }$version"
done

echo "Python $wanted is needed: found none that runs and can make environments (on Debian that takes python3-venv)" >&2
exit 1
