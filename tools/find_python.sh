#!/bin/sh
# Print the path of a Python 3.12 that can make virtual environments, or say what to install.
# A name on PATH proves nothing (pyenv's shims fail when run), so every candidate is run.

probe='
import sys
if sys.version_info[:2] != (3, 12):
    sys.exit(1)
print(getattr(sys, "_base_executable", "") or sys.executable)  # not a venv: it may go stale
import ensurepip, ssl, venv
'
incomplete=

# try CANDIDATE: print its base interpreter and leave, if it will do
try() {
    [ -n "$1" ] || return 0
    if found=$("$1" -I -c "$probe" 2>/dev/null); then
        printf '%s\n' "$found"
        exit 0
    fi
    [ -z "$found" ] || incomplete=$found
}

try "${PYTHON-}"
try python3.12
try python3
for python in \
    "${PYENV_ROOT:-${HOME-}/.pyenv}"/versions/3.12*/bin/python3.12 \
    "${UV_PYTHON_INSTALL_DIR:-${XDG_DATA_HOME:-${HOME-}/.local/share}/uv/python}"/cpython-3.12*/bin/python3.12
do
    try "$python"
done
for uv in uv "${HOME-}/.local/bin/uv" "${HOME-}/.cargo/bin/uv"; do
    try "$("$uv" python find 3.12 2>/dev/null)"
done

{
    if [ -n "$incomplete" ]; then
        echo "seft: $incomplete is a Python 3.12, but lacks venv, ensurepip or ssl."
    else
        echo "seft: no Python 3.12 found; the wheels of ROS 2 Jazzy need exactly that version."
    fi
    cat <<'TEXT'
Install one, then type make again:
  Ubuntu 24.04        sudo apt install python3.12 python3.12-venv
  Debian 12, by uv    sudo apt install pipx && pipx install uv && ~/.local/bin/uv python install 3.12
  Debian 12, by pyenv sudo apt install git curl build-essential libssl-dev zlib1g-dev libbz2-dev \
                        libreadline-dev libsqlite3-dev libffi-dev liblzma-dev
                      git clone https://github.com/pyenv/pyenv ~/.pyenv
                      ~/.pyenv/bin/pyenv install 3.12
If it is somewhere else: make setup PYTHON=/path/to/python3.12
TEXT
} >&2
exit 2
