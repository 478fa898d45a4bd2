#!/bin/sh
# SPDX-License-Identifier: GPL-3.0-or-later
# Makes a virtual environment with all that the project needs: `tools/make_environment.sh .venv 3.11 3.13`.
#
# It gets the first of these versions of Python that runs here, or BASE_PYTHON where that is set. An environment that is
# there already keeps its Python, and only gets what the lock file of that version says by now.
set -eu
cd "$(dirname "$0")/.."

folder=$1
shift
versions=$*

# Prints the version of Python $1; ends the script where that is none of those wanted.
known_version() {
    found=$("$1" -c "import sys; print('%d.%d' % sys.version_info[:2])")
    case " $versions " in
        *" $found "*) echo "$found" ;;
        *)
            echo "$1 is Python $found, and NeuralGuide needs here: $versions" >&2
            exit 1
            ;;
    esac
}

if ! "$folder/bin/python" -c "import pip" 2>/dev/null; then
    # shellcheck disable=SC2086 # versions are words
    base=${BASE_PYTHON:-$(tools/find_python.sh $versions)}
    known_version "$base" >/dev/null
    "$base" -m venv "$folder"
fi
version=$(known_version "$folder/bin/python")
"$folder/bin/python" -m pip install --disable-pip-version-check --quiet -r "requirements-$version.lock"
touch "$folder/installed"
