#!/bin/sh
# Make or bring up to date the environment .venv: Python >= 3.11, no root, nothing but the package
# index. Every package is pinned in requirements.lock and checked against its hash there.
set -eu
cd "$(dirname "$0")"
PYTHON="${PYTHON:-python3}"
PIECE=12             # packages per call of pip: the disk never holds every wheel beside the environment
NEEDED_MIB=9000      # the environment has 7 GB, and one piece's wheels stand beside it for a while
lock_done=.venv/.heliograph-lock
project_done=.venv/.heliograph-project

fail() {
    printf '\nsetup.sh: %s\n' "$1" >&2
    exit 1
}

pip() {
    .venv/bin/python -m pip --disable-pip-version-check install --quiet --no-cache-dir --no-deps "$@"
}

is_done() { # is_done FILE COPY: FILE has not changed since COPY was made of it
    [ -f "$2" ] && cmp -s "$1" "$2"
}

# split LOCK FOLDER: the lock in files of PIECE requirements each, hashes with their requirement.
# 00 holds what pip needs to install others: a build back-end and the runtime of karellen-llvm-core.
split() {
    awk -v piece="$PIECE" -v folder="$2" '
        /^#/ || /^[[:space:]]*$/ { next }
        /^[^[:space:]]/ {
            if ($0 ~ /^(setuptools|wheel-axle-runtime)==/) number = 0
            else { number = 1 + int(count / piece); count++ }
        }
        { print > sprintf("%s/%02d", folder, number) }
    ' "$1"
}

install_lock() {
    pieces=$(mktemp -d)
    trap 'rm -rf "$pieces"' EXIT
    split requirements.lock "$pieces"
    of=$(find "$pieces" -type f | wc -l)
    number=0
    for piece in "$pieces"/*; do
        number=$((number + 1))
        first=$(sed -n '1s/==.*//p' "$piece")
        last=$(sed -n 's/^\([^[:space:]=]*\)==.*/\1/p' "$piece" | tail -n 1)
        echo "  [$number/$of] $first ... $last"
        pip --require-hashes --no-build-isolation --use-pep517 --requirement "$piece" ||
            fail "pip could not install the packages above; its message says why.
  Run setup.sh again: it goes on where it stopped."
    done
    cp requirements.lock "$lock_done"
}

command -v "$PYTHON" >/dev/null || fail "there is no '$PYTHON'; set PYTHON to a Python >= 3.11"
"$PYTHON" -c 'import sys; sys.exit(sys.version_info < (3, 11))' ||
    fail "Heliograph needs Python 3.11 or newer, this is $("$PYTHON" --version); set PYTHON to another"

if is_done requirements.lock "$lock_done" && is_done pyproject.toml "$project_done"; then
    exit 0
fi

if [ ! -x .venv/bin/python ]; then
    free=$(df -Pm . | awk 'NR == 2 { print $4 }')
    [ "$free" -ge "$NEEDED_MIB" ] || fail "$free MiB are free on this disk; $NEEDED_MIB are needed"
    echo "making the environment .venv"
    "$PYTHON" -m venv .venv || fail "'$PYTHON -m venv' failed; does this Python have its venv package?"
fi

if ! is_done requirements.lock "$lock_done"; then
    echo "installing requirements.lock (7 GB, half of it CUDA libraries that torch's wheel links against)"
    install_lock
fi

echo "installing Heliograph itself"
pip --no-build-isolation --editable . || fail "pip could not install this folder; its message says why"
cp pyproject.toml "$project_done"

.venv/bin/heliograph doctor
