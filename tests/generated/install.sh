#!/bin/bash
# What makes a client in TypeScript of /openapi.json, from npm: `make test-clients`.
#
#     tests/generated/install.sh FOLDER
#
# Where it cannot be had, the reason is left in FOLDER/npm.missing, and its test is skipped with that. Packages are
# pinned by hashes, their scripts are not run, and nothing of this shell's environment, in which secrets may be, is theirs.
set -uo pipefail
here=$(cd "$(dirname "$0")" && pwd)
mkdir -p "$1/home"
folder=$(cd "$1" && pwd)
cmp -s "$here/npm/package-lock.json" "$folder/npm.made" && exit
rm -rf "$folder/npm" && mkdir "$folder/npm" && cp "$here"/npm/*.json "$folder/npm" && cd "$folder/npm" || exit
# A registry that does not answer within two minutes is one that cannot be had.
if timeout 120 env -i PATH="$PATH" HOME="$folder/home" LANG=C.UTF-8 \
  npm ci --ignore-scripts --no-audit --no-fund --loglevel=error >"$folder/npm.log" 2>&1; then
  cp "$here/npm/package-lock.json" "$folder/npm.made"
  rm -f "$folder/npm.missing"
else
  rm -f "$folder/npm.made"
  grep -iE 'error|not found|no such' "$folder/npm.log" | tail -1 >"$folder/npm.missing"
  [ -s "$folder/npm.missing" ] || echo "npm gave up: see $folder/npm.log" >"$folder/npm.missing"
  echo "npm: not to be had here ($(cat "$folder/npm.missing"))"
fi
