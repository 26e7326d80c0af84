#!/bin/sh
# Lists what twind brings: sbom.sh FOLDER, of the wheel of twind there, writes a CycloneDX file beside it. With
# `audit` in place of FOLDER (`make audit`) the same distributions are looked up among published vulnerabilities.
set -eu
here=$(cd "$(dirname "$0")" && pwd)
source=$(dirname "$here")
asked=${1:?usage: sbom.sh FOLDER | audit}
python=${PYTHON:-python3}
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

pip() { "$work/tools/bin/python" -m pip --disable-pip-version-check --quiet "$@"; }

case $asked in
audit)
    tools=pip-audit
    folder=$work
    "$here/install.sh" own "$folder"
    ;;
*)
    tools="cyclonedx-bom==7.5.0"
    folder=$asked
    ;;
esac
"$python" -m venv "$work/tools"
pip install "$tools"
# Without pip, so that nothing is listed that twind does not bring.
"$python" -m venv --without-pip "$work/twind"
pip --python "$work/twind/bin/python" install --only-binary :all: --constraint "$source/constraints.txt" "$folder"/twind_robot-*.whl

if [ "$asked" = audit ]; then
    pip --python "$work/twind/bin/python" uninstall --yes twind-robot
    # --strict: a distribution that was not looked up is no success.
    "$work/tools/bin/pip-audit" --strict --progress-spinner off --path "$work"/twind/lib/python3*/site-packages
else
    version=$(sed -n 's/^__version__ = "\(.*\)"$/\1/p' "$source/twind/version.py")
    # With texts: a licence in words of its own ("Apache 2.0") would be left out without them.
    "$work/tools/bin/cyclonedx-py" environment --gather-license-texts --output-reproducible --short-PURLs --of JSON \
        --output-file "$folder/twind_$version.cdx.json" "$work/twind"
fi
