#!/bin/sh
# Builds the Debian package with dpkg-deb alone: `make deb`, or deb.sh FOLDER. Prints the package's path.
#
# The package carries wheels of twind and of all it needs; its environment is made of them on the robot, without a
# network and without a compiler. Wheels fit certain versions of Python, so the package depends on these.
#
# PYTHON   the interpreter to build with and for (as in install.sh)
# PYTHONS  further versions to serve, "3.12 3.13": wheels for them are fetched too
# ARCHITECTURE  of the robot, "arm64" (this machine's): its wheels are fetched, nothing is compiled
# WHEELS   a folder that has all wheels already; nothing is fetched then
# EXTRAS   further packages that come along and are installed (as in install.sh)
# SOURCE_DATE_EPOCH  the time in the package; else that of the last commit. The same sources give the same package
set -eu
umask 022

here=$(cd "$(dirname "$0")" && pwd)
source=$(dirname "$here")
out=${1:?usage: deb.sh FOLDER}
mkdir -p "$out"
command -v dpkg-deb >/dev/null || { echo "twind: no dpkg-deb here; it builds the package" >&2; exit 1; }
SOURCE_DATE_EPOCH=${SOURCE_DATE_EPOCH:-$(git -C "$source" log -1 --format=%ct 2>/dev/null || date +%s)}
export SOURCE_DATE_EPOCH

version=$(sed -n 's/^__version__ = "\(.*\)"$/\1/p' "$source/twind/version.py")
[ -n "$version" ] || { echo "twind: no version in twind/version.py" >&2; exit 1; }
architecture=${ARCHITECTURE:-$(dpkg --print-architecture)}
case $architecture in
amd64) MACHINE=x86_64 ;;
arm64) MACHINE=aarch64 ;;
*) echo "twind: ARCHITECTURE=$architecture: packages are made for amd64 and arm64" >&2; exit 1 ;;
esac
export MACHINE
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
tree=$work/tree
sed -n '/^purge() {$/,/^}$/p' "$here/install.sh" >"$work/purge"
[ -s "$work/purge" ] || { echo "twind: no purge() in $here/install.sh; the package's postrm calls it" >&2; exit 1; }

# ---------------------------------------------------------------------------------- what the package holds

export DESTDIR="$tree" LIB=/usr/lib SHARE=/usr/share BIN=/usr/bin
"$here/install.sh" files
"$here/install.sh" settings
rm -r "$tree/opt"  # the list of files is dpkg's, the environment is made on the robot

install -D -m 0755 "$here/install.sh" "$tree/usr/lib/twind/install.sh"
if [ -n "${WHEELS:-}" ]; then
    mkdir -p "$tree/usr/lib/twind/wheels"
    cp "$WHEELS"/*.whl "$tree/usr/lib/twind/wheels"
else
    "$here/install.sh" own "$tree/usr/lib/twind/wheels"
fi
pythons=$("$here/install.sh" version)
ordered=$(printf '%s\n' "$pythons" ${PYTHONS:-} | sort -uV)
if [ -z "${WHEELS:-}" ]; then
    for each in $ordered; do
        "$here/install.sh" foreign "$tree/usr/lib/twind/wheels" "$each"
    done
fi
chmod 0644 "$tree"/usr/lib/twind/wheels/*.whl
printf '%s\n' "${EXTRAS:-}" >"$tree/usr/lib/twind/extras"
first=$(echo "$ordered" | head -n 1)
last=$(echo "$ordered" | tail -n 1)

document=$tree/usr/share/doc/twind
install -m 0644 "$here/debian/copyright" "$document/copyright"
{
    echo "twind ($version) unstable; urgency=medium"
    echo
    echo "  * What changed stands in CHANGELOG.md of the sources."
    echo
    echo " -- twind developers <twind@users.noreply.github.com>  $(date -u -R -d "@$SOURCE_DATE_EPOCH")"
} | gzip -9n >"$document/changelog.gz"

# -------------------------------------------------------------------------------------- what dpkg is told

control=$tree/DEBIAN
mkdir -p "$control"
for each in preinst postinst prerm postrm; do
    install -m 0755 "$here/debian/$each" "$control/$each"
done
sed -i -e "/^# @PURGE@$/{r $work/purge" -e 'd;}' "$control/postrm"
(cd "$tree" && find etc -type f | LC_ALL=C sort | sed 's|^|/|') >"$control/conffiles"
(cd "$tree" && find usr -type f | LC_ALL=C sort | xargs -d '\n' md5sum) >"$control/md5sums"
sed -e "s/@VERSION@/$version/" -e "s/@ARCHITECTURE@/$architecture/" -e "s/@FIRST@/$first/" \
    -e "s/@NEXT@/${last%.*}.$((${last#*.} + 1))/" \
    -e "s/@SIZE@/$(cd "$tree" && find etc usr -type f -printf '%s\n' | awk '{ kib += int(($1 + 1023) / 1024) } END { print kib }')/" \
    "$here/debian/control" >"$control/control"
chmod 0644 "$control/conffiles" "$control/md5sums" "$control/control"
find "$tree" -exec touch -h -d "@$SOURCE_DATE_EPOCH" {} +

package=$out/twind_${version}_$architecture.deb
# Wheels are compressed already; what is left is little.
dpkg-deb --root-owner-group -Zgzip -z6 --build "$tree" "$package" >/dev/null
echo "$package"
