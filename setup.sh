#!/bin/sh
# Make or bring up to date the environment .venv: Python >= 3.11, no root, nothing but the package
# index. Every package is pinned in requirements.lock and checked against its hash there.
#
#   sh setup.sh          the environment of this checkout
#   sh setup.sh --keep   the same, and its packages are kept for other checkouts on this machine: their
#                        set-up starts from links to them, and asks the index only for what differs
set -eu
cd "$(dirname "$0")"
PYTHON="${PYTHON:-python3}"
NEEDED_MIB=9000      # the environment has 7 GB
lock_done=.venv/.heliograph-lock
project_done=.venv/.heliograph-project
kept="${XDG_CACHE_HOME:-${HOME:-/nonexistent}/.cache}/heliograph/environment"

fail() {
    printf '\nsetup.sh: %s\n' "$1" >&2
    exit 1
}

# Modules are compiled when they are first imported, most of the 7 GB never: those in use by the
# doctor at the end
pip() {
    .venv/bin/python -m pip --disable-pip-version-check install --quiet --no-cache-dir --no-deps --no-compile "$@"
}

tell() { # tell VARIABLE NAME: uv, what pip's files or environment say of NAME; it asks neither
    told=$(printf '%s\n' "$pip_settings" | sed -n "s/^[:a-z]*\.$2='\(.*\)'\$/\1/p" | head -n 1 | sed 's/\\n/ /g; s/^ //')
    [ -z "$told" ] || [ -n "$(printenv "$1")" ] || export "$1=$told"
}

# uv takes a third of pip's time. What it has loaded lies beside the packages, so that it is linked and
# not copied, and until all is there, so that an interrupted run goes on where it stopped.
uv() {
    pip_settings=$(.venv/bin/python -m pip --disable-pip-version-check config list)
    tell UV_DEFAULT_INDEX index-url
    tell UV_INDEX extra-index-url
    tell UV_FIND_LINKS find-links
    tell UV_NO_INDEX no-index
    tell UV_INSECURE_HOST trusted-host
    tell SSL_CERT_FILE cert
    tell HTTPS_PROXY proxy
    UV_CACHE_DIR=.venv/.uv .venv/bin/uv pip install --python .venv/bin/python --no-deps "$@"
}

is_done() { # is_done FILE COPY: FILE has not changed since COPY was made of it
    [ -f "$2" ] && cmp -s "$1" "$2"
}

note() { # note FILE COPY: FILE is done. A new COPY, for the old one may be a link to another checkout's
    rm -f "$2"
    cp "$1" "$2"
}

# What installs the others comes first, by pip: uv, a build back-end, what karellen-llvm-core's wheel runs
install_lock() {
    first=.venv/.first.lock
    awk '/^[^[:space:]]/ { on = /^(setuptools|uv|wheel-axle-runtime)==/ } on' requirements.lock >"$first"
    again="Run setup.sh again: it goes on where it stopped."
    pip --require-hashes --requirement "$first" ||
        fail "pip could not install the packages in $first; its message says why.
  $again"
    uv --require-hashes --no-build-isolation --requirement requirements.lock || {
        echo "uv could not install requirements.lock; its message says why. pip tries, which takes longer"
        pip --require-hashes --no-build-isolation --use-pep517 --requirement requirements.lock ||
            fail "pip could not either; its message says why.
  $again"
    }
    rm -rf .venv/.uv "$first"
    note requirements.lock "$lock_done"
}

# copy FROM TO: links to the same files, copies where the file system cannot link
copy() {
    cp -al "$1" "$2" 2>/dev/null || { rm -rf "$2" && cp -a "$1" "$2"; }
}

# alone COMMAND: runs it while no other checkout touches the kept packages
alone() {
    mkdir -p "$(dirname "$kept")"
    (flock 9 && "$@") 9>"$kept.lock"
}

keep() {
    rm -rf "$kept.new"
    copy .venv "$kept.new"
    rm -rf "$kept"
    mv "$kept.new" "$kept"
    echo "packages kept in $kept; delete that folder to be rid of them"
}

version_of() { # version_of PYTHON: its version, compiler and build
    "$1" -c 'import sys; print(sys.version)'
}

# start_from_kept: .venv from the kept environment; fails where there is none of this Python, or where
# a script's first line cannot name this folder. Scripts name the folder they were installed in.
start_from_kept() {
    case "$PWD" in *[[:space:]]*) return 1 ;; esac
    [ "${#PWD}" -lt 100 ] || return 1
    [ -x "$kept/bin/python" ] && [ "$(version_of "$kept/bin/python")" = "$(version_of "$PYTHON")" ] ||
        return 1
    echo "starting from the packages in $kept"
    alone copy "$kept" .venv || fail "the packages in $kept could not be copied; is the disk full?"
    "$PYTHON" - .venv <<'END' || { rm -rf .venv; fail "the packages in $kept are not whole; delete that folder"; }
import re, sys
from pathlib import Path

new = Path(sys.argv[1]).resolve()
settings = new / "pyvenv.cfg"
old = re.search(r"^command = .* -m venv (.+)$", settings.read_text(), flags=re.MULTILINE)[1]
for file in [settings, *(f for f in (new / "bin").iterdir() if f.is_file() and not f.is_symlink())]:
    data = file.read_bytes()
    if old.encode() in data:
        mode = file.stat().st_mode
        file.unlink()  # a link to the kept file, which must stay as it is
        file.write_bytes(data.replace(old.encode(), str(new).encode()))
        file.chmod(mode)
END
    rm -f "$project_done"
}

make_environment() {
    # shellcheck disable=SC2046  # the words of a line
    set -- $(df -Pm . | tail -n 1)
    [ "$4" -ge "$NEEDED_MIB" ] || fail "$4 MiB are free on this disk; $NEEDED_MIB are needed"
    echo "making the environment .venv"
    "$PYTHON" -m venv .venv || fail "'$PYTHON -m venv' failed; does this Python have its venv package?"
}

case "${1:-}" in
    "" | --keep) ;;
    *) fail "unknown argument '$1'; the only one is --keep" ;;
esac
command -v "$PYTHON" >/dev/null || fail "there is no '$PYTHON'; set PYTHON to a Python >= 3.11"
"$PYTHON" -c 'import sys; sys.exit(sys.version_info < (3, 11))' ||
    fail "Heliograph needs Python 3.11 or newer, this is $("$PYTHON" --version); set PYTHON to another"

if is_done requirements.lock "$lock_done" && is_done pyproject.toml "$project_done"; then
    [ -z "${1:-}" ] || alone keep
    exit 0
fi

[ -x .venv/bin/python ] || start_from_kept || make_environment

if ! is_done requirements.lock "$lock_done"; then
    echo "installing requirements.lock (7 GB, half of it CUDA libraries that torch's wheel links against)"
    install_lock
fi

echo "installing Heliograph itself"
pip --no-build-isolation --editable . || fail "pip could not install this folder; its message says why"
note pyproject.toml "$project_done"

# Containers often forbid Python to keep what it compiles, for small images; then every stage and every
# test would compile the same modules again, for one to three seconds
unset PYTHONDONTWRITEBYTECODE
.venv/bin/heliograph doctor
[ -z "${1:-}" ] || alone keep
