#!/bin/sh
# Builds all that a release publishes: `make release`, or release.sh FOLDER. `tools/check_release.py` tries it.
#
#   twind_robot-*.whl, lerobot_robot_twind-*.whl    the distributions of this repository
#   twind_*_amd64.deb, twind_*_arm64.deb            with the wheels of all that twind needs
#   twind_*.cdx.json                                what is in them, as CycloneDX
#   SHA256SUMS
#
# PYTHONS        versions that the packages serve ("3.11 3.12 3.13 3.14")
# ARCHITECTURES  of the packages ("amd64 arm64")
# PYTHON, SOURCE_DATE_EPOCH  as in deb.sh. The same sources and wheels give the same files
set -eu
umask 022

here=$(cd "$(dirname "$0")" && pwd)
source=$(dirname "$here")
out=${1:?usage: release.sh FOLDER}
export PYTHONS="${PYTHONS:-3.11 3.12 3.13 3.14}"
SOURCE_DATE_EPOCH=${SOURCE_DATE_EPOCH:-$(git -C "$source" log -1 --format=%ct)}
export SOURCE_DATE_EPOCH
mkdir -p "$out"
rm -f "$out"/*.whl "$out"/*.deb "$out"/*.cdx.json "$out"/SHA256SUMS

SCRATCH=$(mktemp -d)  # one pip for all steps of install.sh
export SCRATCH
trap 'rm -rf "$SCRATCH"' EXIT
trap 'exit 130' INT TERM HUP
"$here/install.sh" own "$out"
"$here/install.sh" own "$out" "$source/integrations/lerobot"
# The first package has the versions that the tests run with; all packages and the bill of materials have its.
export PIP_CONSTRAINT="$source/constraints.txt"
versions=$SCRATCH/of-packages
for each in ${ARCHITECTURES:-amd64 arm64}; do
    package=$(ARCHITECTURE=$each "$here/deb.sh" "$out")
    dpkg-deb --fsys-tarfile "$package" | tar --list |
        sed -n '/twind_robot-/d; s|.*/wheels/\([^-]*\)-\([^-]*\)-.*|\1==\2|p' | sort -u >"$versions"
    export PIP_CONSTRAINT="$versions"
done
"$here/sbom.sh" "$out"
(cd "$out" && sha256sum -- *.whl *.deb *.cdx.json >SHA256SUMS)
ls -l "$out"
