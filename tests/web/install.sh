#!/bin/sh
# A Chromium for `make test-web`, where it is missing and can be had: by apt-get, as root. Else its tests say so.
for name in chromium chromium-browser google-chrome; do
  command -v "$name" >/dev/null && exit 0
done
if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
  echo "Installing Chromium, once: 100 MB to download, a minute."
  DEBIAN_FRONTEND=noninteractive timeout 300 sh -c \
    'apt-get update -q && apt-get install -q -y --no-install-recommends chromium' >/dev/null 2>&1 </dev/null ||
    echo "Chromium could not be installed"
else
  echo "Chromium is missing; Debian, Ubuntu: apt-get install -y chromium, as root"
fi
