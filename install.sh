#!/bin/sh
# sh install.sh [test]: makes .venv beside this file and installs form_drake into it, with the system
# libraries it needs (Debian 12, Debian 13, Ubuntu 24.04; as root or with sudo). "test" adds the tools
# of the tests, a browser among them where root runs it on Debian. Run again, it does only what is
# missing.
set -eu

fail() {
  echo "install.sh: $*" >&2
  exit 1
}

case "${1-}" in
  "") extra="" ;;
  test) extra="[test]" ;;
  *) fail "got '$1'; allowed: no argument, or test" ;;
esac
cd "$(dirname "$0")"
venv=$PWD/.venv
log=$PWD/.venv/install.log

run() { # what it is, command...: its output goes to the screen only if it fails
  what=$1
  shift
  output=$("$@" 2>&1 </dev/null) || {
    printf '%s\n' "$output" >&2
    fail "could not $what (output above)"
  }
}

# --- system packages ---------------------------------------------------------------------------
find_python() { # modules...: sets $python to the first that is new enough and has them
  for python in python3 python3.13 python3.12 python3.11; do
    "$python" -c "import sys$*; sys.exit(sys.version_info < (3, 11))" 2>/dev/null && return 0
  done
  return 1
}

packages() { # library of drake, open3d or pyrealsense2; the Debian package that brings it
  loaded=$(PATH=$PATH:/sbin:/usr/sbin ldconfig -p 2>/dev/null || true)
  while read -r library package; do
    case "$loaded" in
      *"$library "*) ;;
      *) printf '%s ' "$package" ;;
    esac
  done <<LIBRARIES
libEGL.so.1 libegl1
libGL.so.1 libgl1
libX11.so.6 libx11-6
libglib-2.0.so.0 libglib2.0-bin
libidn2.so.0 libidn2-0
libusb-1.0.so.0 libusb-1.0-0
LIBRARIES
}

works() { # whether .venv has a python that runs, is new enough and has pip
  "$venv/bin/python" -c 'import sys, pip; sys.exit(sys.version_info < (3, 11))' 2>/dev/null
}

browser() { # Debian's package of the browser that opens pages in a test, which does without it
  [ -n "$extra" ] && ! command -v chromium >/dev/null && ! command -v google-chrome >/dev/null &&
    grep -q '^ID=debian$' /etc/os-release 2>/dev/null && [ "$(id -u)" -eq 0 ] && echo chromium || :
}

missing="$(packages)$(browser)"
if ! works && ! find_python ", ensurepip, venv"; then
  ! command -v python3 >/dev/null || find_python || fail "needs Python 3.11 or newer, found $(python3 -V 2>&1)"
  missing="python3-venv $missing"
fi
missing=${missing% }
if [ -n "$missing" ]; then
  command -v apt-get >/dev/null || fail "no apt-get here; install what Debian calls: $missing"
  sudo=
  if [ "$(id -u)" -ne 0 ]; then
    command -v sudo >/dev/null || fail "needs root once: apt-get install $missing"
    sudo=sudo
  fi
  echo "install.sh: apt-get install $missing"
  run "update the package lists" $sudo env DEBIAN_FRONTEND=noninteractive apt-get update -q
  # shellcheck disable=SC2086
  run "install $missing" $sudo env DEBIAN_FRONTEND=noninteractive \
    apt-get install -q -y --no-install-recommends $missing
fi

# --- the environment ---------------------------------------------------------------------------
if ! works; then
  find_python ", ensurepip, venv" ||
    fail "needs Python 3.11 or newer with venv, found $(python3 -V 2>&1 || echo none)"
  run "make .venv" "$python" -m venv --clear "$venv"
fi

stamp=$venv/form-drake.stamp # what .venv was made from; the test set contains the plain one
wanted=$("$venv/bin/python" -V; echo "$PWD"; cat pyproject.toml constraints.txt)
wanted=$(printf '%s' "$wanted" | cksum)
case "$(cat "$stamp" 2>/dev/null || true)" in
  "$wanted $extra" | "$wanted [test]") exit 0 ;;
esac
echo "install.sh: pip install -e .$extra into .venv (a minute or more; log: .venv/install.log)"
rm -f "$stamp"
"$venv/bin/python" -m pip install --quiet --disable-pip-version-check --no-input \
  -c constraints.txt -e ".$extra" >"$log" 2>&1 </dev/null || {
  tail -n 20 "$log" >&2
  fail "pip could not install .$extra (output above, all of it in .venv/install.log)"
}
echo "$wanted $extra" >"$stamp"
