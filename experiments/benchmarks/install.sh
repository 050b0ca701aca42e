#!/usr/bin/env bash
# The README's first line as a newcomer runs it: new clone, new environment, no cache of
# compiled programs. Writes its seconds and megabytes to results/install.json.
set -euo pipefail
here="$(cd "$(dirname "$0")" && pwd)"
work="$(mktemp -d)"
trap 'rm -rf "$work"' EXIT
git clone -q "$here/../.." "$work/clone"
cd "$work/clone"
export HOME="$work/home"
mkdir -p "$HOME"

start=$(date +%s)
python3 -m venv .venv
.venv/bin/pip install -q --no-cache-dir -c constraints.txt .
installed=$(date +%s)
.venv/bin/jaxgrow grow --out polyp
grown=$(date +%s)
.venv/bin/jaxgrow grow --out again >/dev/null
again=$(date +%s)
.venv/bin/jaxgrow audit polyp >/dev/null
cmp polyp/organ.ply again/organ.ply

cat >"$here/../results/install.json" <<JSON
{
 "install_seconds": $((installed - start)),
 "install_megabytes": $(du -sm .venv | cut -f1),
 "first_growth_seconds": $((grown - installed)),
 "second_growth_seconds": $((again - grown)),
 "python": "$(.venv/bin/python -c 'import platform; print(platform.python_version())')",
 "processors": $(nproc)
}
JSON
cat "$here/../results/install.json"
