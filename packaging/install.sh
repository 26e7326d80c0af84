#!/bin/sh
# Puts twind on a machine and takes it off again: `make install`, `make uninstall` and the Debian package call this.
#
#   install.sh install      wheels, files, settings, environment, users; then what to do next
#   install.sh uninstall    stops the services, removes all of it but settings, state and user (PURGE=1: all but the user)
#   and the steps of these, for the package: own DIR, wheels DIR, foreign DIR PYTHON, files, settings,
#   environment DIR, register, stop, remove, next, version
#
# DESTDIR  a tree to install into instead of this machine: no users are made, nothing is started or reloaded
# LIB      where units, rules, users and folders are described (/usr/local/lib)
# SHARE    where pages, examples, manuals and completions go (/usr/local/share)
# BIN      where the commands are found (/usr/local/bin)
# PYTHON   the interpreter (the first of /usr/bin/python3, /usr/local/bin/python3, python3 that will do)
# WHEELS   a folder with wheels of twind and of what it needs; without it they are fetched
# MACHINE  of `foreign`: the processor that wheels are for, "aarch64" (this one's)
# EXTRAS   further packages by the names of pyproject.toml, "ros" or "zenoh,view" (those of the installation before)
#
# /opt/twind/versions/ID is a virtual environment, ID its version and a digest of what is in it; /opt/twind/bin points
# into the one in force and is switched when the new one is whole. A daemon that runs goes on with its own files.
set -eu
umask 022  # everybody may read and run what is installed, whatever the umask of who installs it

DESTDIR=${DESTDIR:-}
LIB=${LIB:-/usr/local/lib}
SHARE=${SHARE:-/usr/local/share}
BIN=${BIN:-/usr/local/bin}
HOME_OF_TWIND=/opt/twind
COMMANDS="twind twindctl twind-virtual"
SOURCE=$(cd "$(dirname "$0")/.." && pwd)
REFUSED="twind@sim.service twind@twind.service"  # masked: their sockets, or settings, are another unit's
TAB=$(printf '\t')
EXTRAS=${EXTRAS-$(cat "$DESTDIR$HOME_OF_TWIND/extras" 2>/dev/null || :)}

say() { printf '%s\n' "$*"; }
fail() { printf 'twind: %s\n' "$*" >&2; exit 1; }

# ------------------------------------------------------------------------------------------ the interpreter

# Why this interpreter cannot serve; nothing: it can.
unfit() {
    "$1" -c '
import sys
prefix = sys.base_prefix.split("/")[1:]
if sys.version_info < (3, 11):
    print("it is Python %d.%d, and twind needs 3.11 or newer" % sys.version_info[:2])
elif prefix[:1] in (["home"], ["root"]) or prefix[:2] == ["run", "user"]:  # ProtectHome= hides it: systemd.exec(5)
    print("it stands in %s, which the service does not see" % sys.base_prefix)
else:
    try:
        import ensurepip, venv
    except ImportError:
        print("it has no venv with pip (on Debian: apt install python3-venv)")
' 2>/dev/null || say "it does not run"
}

python() {
    if [ -n "${PYTHON:-}" ]; then
        why=$(unfit "$PYTHON")
        [ -z "$why" ] || fail "PYTHON=$PYTHON: $why; name another with PYTHON="
        command -v "$PYTHON"
        return
    fi
    reasons=
    for each in /usr/bin/python3 /usr/local/bin/python3 python3; do
        why=$(unfit "$each")
        [ -n "$why" ] || { command -v "$each"; return; }
        reasons="$reasons
  $each: $why"
    done
    fail "no interpreter will do; name one with PYTHON=$reasons"
}

# ----------------------------------------------------------------------------------------------- the steps

# The wheel of twind, or of the sources $2, into folder $1: built from Python alone. The same sources give the same bytes.
own() {
    python=$(python)
    mkdir -p "$1"
    scratch
    tools=$SOURCE/packaging/build-constraints.txt
    PIP_CONSTRAINT=$tools PIP_BUILD_CONSTRAINT=$tools pip wheel --no-deps --wheel-dir "$1" "${2:-$SOURCE}" ||
        fail "the wheel of ${2:-twind} was not built; its own words are above"
}

# Wheels of twind and of all it needs into folder $1. No compiler: what has no wheel for this machine is refused.
wheels() {
    own "$1"
    pip download --only-binary :all: --dest "$1" "$(extended "$1"/twind_robot-*.whl)" ||
        fail "a wheel is missing: without a way to the index, give a folder that has them with WHEELS="
}

# What pip calls $1 with the extras.
extended() { say "$1${EXTRAS:+[$EXTRAS]}"; }

# A folder that goes when we do (or SCRATCH, for several steps), and in it a pip of `$python`.
scratch() {
    if [ -z "${SCRATCH:-}" ]; then
        SCRATCH=$(mktemp -d)
        trap 'rm -rf "$SCRATCH"' EXIT
        trap 'exit 130' INT TERM HUP
    fi
    [ -e "$SCRATCH/pip" ] || "$python" -m venv "$SCRATCH/pip"
}

pip() { "$SCRATCH/pip/bin/python" -m pip --disable-pip-version-check --quiet "$@"; }

# Wheels into folder $1 for Python $2 or MACHINE, another than ours, in the versions that are there already.
foreign() {
    python=$(python)
    machine=${MACHINE:-$("$python" -c 'import platform; print(platform.machine())')}
    set -- "$1" "$2" "cp$(say "$2" | tr -d .)"
    platforms=$(for minor in 5 12 17 24 26 27 28; do say "--platform manylinux_2_${minor}_$machine"; done)
    scratch
    (cd "$1" && ls -- *.whl) | sed '/^twind_robot-/d; s/^\([^-]*\)-\([^-]*\)-.*/\1==\2/' >"$SCRATCH/versions"
    # shellcheck disable=SC2086  # one word each
    pip download --only-binary :all: --dest "$1" --find-links "$1" --constraint "$SCRATCH/versions" --python-version "$2" --implementation cp \
        --abi "$3" --abi abi3 --abi none $platforms "$(extended "$1"/twind_robot-*.whl)" ||
        fail "a wheel for Python $2 is missing; its own words are above"
}

# Which Python this is, as 3.11.
version() { "$(python)" -c 'import sys; print("%d.%d" % sys.version_info[:2])'; }

# Each file that does not change: from, a tab, to.
listed() {
    for each in "$SOURCE"/systemd/*.service "$SOURCE"/systemd/*.socket; do
        pair "$each" "$LIB/systemd/system/${each##*/}"
    done
    pair "$SOURCE/systemd/sysusers.d/twind.conf" "$LIB/sysusers.d/twind.conf"
    pair "$SOURCE/systemd/tmpfiles.d/twind.conf" "$LIB/tmpfiles.d/twind.conf"
    pair "$SOURCE/systemd/udev/60-twind.rules" "$LIB/udev/rules.d/60-twind.rules"
    # Pages lie as in the sources, with what they link to, so that the links lead somewhere.
    for each in README.md CHANGELOG.md calibration/README.md systemd/README.md \
        $(cd "$SOURCE" && find docs packaging/metrics -type f ! -name '*.cast' | LC_ALL=C sort) \
        twind/robots/h24.yaml twind/robots/h24-mixed.yaml twind/robots/so101.yaml \
        twind/protocol/io.twind.Control.varlink; do
        pair "$SOURCE/$each" "$SHARE/doc/twind/$each"
    done
    for each in "$SOURCE"/systemd/examples/*; do
        pair "$each" "$SHARE/doc/twind/examples/${each##*/}"
    done
}

# Each link: its target, a tab, its place. The environment in force holds commands, manual pages and completions.
linked() {
    case $SHARE in /usr/share) zsh=$SHARE/zsh/vendor-completions ;; *) zsh=$SHARE/zsh/site-functions ;; esac
    for each in $COMMANDS; do
        case $each in twind) section=8 ;; *) section=1 ;; esac
        pair "$HOME_OF_TWIND/bin/$each" "$BIN/$each"
        pair "$HOME_OF_TWIND/bin/../manuals/$each.$section" "$SHARE/man/man$section/$each.$section"
        pair "$HOME_OF_TWIND/bin/../manuals/bash/$each" "$SHARE/bash-completion/completions/$each"
        pair "$HOME_OF_TWIND/bin/../manuals/zsh/_$each" "$zsh/_$each"
    done
    for each in $REFUSED; do
        pair /dev/null "$LIB/systemd/system/$each"
    done
}

pair() { printf '%s\t%s\n' "$1" "$2"; }

# Units, rules, users, folders, examples, commands on PATH, manuals and completions; what an older version had more of goes.
files() {
    kept=$DESTDIR$HOME_OF_TWIND/files
    before=$(cat "$kept" 2>/dev/null || :)
    listed | while IFS=$TAB read -r from to; do
        install -D -m 0644 "$from" "$DESTDIR$to"
    done
    linked | while IFS=$TAB read -r to from; do
        link "$to" "$DESTDIR$from"
    done
    now=$(
        listed | cut -f2
        linked | cut -f2
    )
    say "$before" | while read -r each; do
        [ -z "$each" ] || say "$now" | grep -qxF "$each" || rm -f "$DESTDIR$each"
    done
    mkdir -p "${kept%/*}"
    say "$now" >"$kept"
}

# A link at $2 to $1.
link() {
    mkdir -p "${2%/*}"
    ln -sfn "$1" "$2"
}

# Settings and a robot file to begin with, each only where there is none.
settings() {
    etc=$DESTDIR/etc/twind
    mkdir -p "$etc/robots"
    [ -e "$etc/twind.yaml" ] || install -m 0644 "$SOURCE/packaging/twind.yaml" "$etc/twind.yaml"
    [ -z "$(ls -A "$etc/robots")" ] || return 0
    robots=$SOURCE/twind/robots
    sed -e '1s/^# h24:/# An example, the built-in h24 by another name:/' -e 's/^name: h24$/name: example/' \
        -e 's/mjcf: h24\.xml/mjcf: example.xml/' "$robots/h24.yaml" >"$etc/robots/example.yaml"
    install -m 0644 "$robots/h24.xml" "$etc/robots/example.xml"
    chmod 0644 "$etc/robots/example.yaml"
}

# A virtual environment of the wheels in folder $1, and /opt/twind/bin pointing into it once it is whole.
environment() {
    python=$(python)
    top=$DESTDIR$HOME_OF_TWIND
    [ ! -e "$top/pyvenv.cfg" ] || fail "$top is a virtual environment made by hand: remove it (rm -r $top), then again"
    own=$(cd "$1" && ls twind_robot-*.whl) || fail "$1: no wheel of twind in it"
    version=$(say "$own" | cut -d- -f2)
    digest=$({
        "$python" -c 'import sys; print(sys.version_info[:2], sys.base_prefix)'
        say "$EXTRAS"
        cd "$1" && sha256sum ./*.whl
    } | sha256sum | cut -c1-8)
    id=$version-$digest
    new=$top/versions/$id
    if [ ! -e "$new/whole" ]; then
        rm -rf "$new"
        mkdir -p "$top/versions"
        "$python" -m venv "$new"
        "$new/bin/python" -m pip --disable-pip-version-check --quiet install --no-compile --no-index --find-links "$1" \
            "$(extended twind-robot)" || {
            rm -rf "$new"
            fail "the environment was not made; what was installed before is as it was"
        }
        [ -z "$DESTDIR" ] || relocate "$new"
        # Nobody runs the tests of others there, nor pip; templates of others do not compile.
        "$new/bin/python" -m compileall -q -s "$DESTDIR" -x '/(pip|setuptools|pkg_resources|tests?)/' "$new/lib" \
            >/dev/null || :
        # -I: never the sources of the folder that this is started in. A daemon without manual pages is whole too.
        "$new/bin/python" -IB -m twind.manual.write_manuals "$new/manuals" ||
            say "manual pages and completion scripts were not written: the reason is above"
        : >"$new/whole"
    fi
    ln -sfn "versions/$id/bin" "$top/bin.new"
    mv -T "$top/bin.new" "$top/bin"
    say "$EXTRAS" >"$top/extras"
    for old in "$top/versions"/*; do
        [ "$old" = "$new" ] || retire "$old"
    done
}

# The scripts of an environment made in DESTDIR are to run without it.
relocate() {
    grep -rlIF "$DESTDIR" "$1/bin" "$1/pyvenv.cfg" | while read -r each; do
        [ -L "$each" ] || sed -i "s|$DESTDIR$HOME_OF_TWIND|$HOME_OF_TWIND|g" "$each"
    done
}

# An older environment goes, unless something runs from it: a front that dies is started again from there.
retire() {
    if grep -qsF "$1/" /proc/[0-9]*/maps; then
        say "${1##*/} still runs: \`systemctl restart twind\` when the robot stands safely, then install again to remove it"
    else
        rm -rf "$1"
    fi
}

# What the machine is told: users, folders, units, rules. Each step that it cannot do is said.
register() {
    if command -v systemd-sysusers >/dev/null; then
        systemd-sysusers "$LIB/sysusers.d/twind.conf"
    else
        say "no systemd-sysusers here: user twind and the groups twind-operator and twind-observe were not made"
    fi
    if command -v systemd-tmpfiles >/dev/null; then
        systemd-tmpfiles --create "$LIB/tmpfiles.d/twind.conf"
    else
        say "no systemd-tmpfiles here: /run/twind was not made"
    fi
    reload
    for each in "$LIB"/systemd/system/twind*.service; do
        [ ! -e "/etc/systemd/system/${each##*/}" ] ||
            say "/etc/systemd/system/${each##*/} is in force instead of $each: remove it if it is an older copy"
    done
}

# The service manager and udev read their files anew, where they run.
reload() {
    if [ -d /run/systemd/system ]; then
        systemctl daemon-reload
    else
        say "systemd does not run here: units are read when it does"
    fi
    [ ! -e /run/udev/control ] || ! command -v udevadm >/dev/null || udevadm control --reload || say "udev did not reload: its rules hold after a restart"
}

# Ends all services of ours, as `systemctl stop` does: an armed robot is lowered first. They are not started again.
stop() {
    if [ -d /run/systemd/system ]; then
        # Patterns, all of them: a unit that nobody has loaded is then no error.
        set -- 'twind.servic[e]' 'twind@*.service' 'twind-sim.servic[e]' 'twind-metrics*.service' 'twind-stream*.service' \
            'twind-ros*.service' 'twind-uplink*.service'
        # Services first, as systemctl takes patterns in no order: sockets wait for them, so that a robot on its way
        # down can be stopped. Again with the sockets: a connection may have started one anew.
        systemctl stop --no-block "$@"
        systemctl stop "$@" 'twind-control*.socket' 'twind-observe*.socket'
        outlast
        systemctl reset-failed 'twind*'  # a unit that failed would be listed for ever
    fi
    for each in "$DESTDIR"/etc/systemd/system/*.wants/twind*; do
        [ ! -L "$each" ] || case $(readlink "$each") in
            "$LIB/systemd/system/twind"* | "${LIB#/usr}/systemd/system/twind"*) rm -f "$each" ;;  # /lib is /usr/lib
        esac
    done
}

# Until no fail-safe is at work: one begins when a service ends by force. None is ended by us: it ends by itself.
outlast() {
    until=$(($(date +%s) + 160))  # twice the 75 s of its unit
    waited=
    while busy=$(failsafes) && [ -n "$busy" ]; do
        for each in $busy; do
            case " $waited " in *" $each "*) ;; *) waited="$waited $each"; say "$each is at work: waiting for it" ;; esac
        done
        [ "$(date +%s)" -lt "$until" ] || fail "$each does not end: systemctl status $each; then again"
        sleep 0.2
    done
    for each in $waited; do
        [ "$(systemctl show --property=Result --value "$each")" = success ] ||
            fail "torque may still be on: journalctl -u $each says why; support the robot, then again"
    done
}

# Fail-safes that run, are about to (a job) or are being ended.
failsafes() {
    {
        systemctl list-jobs --no-legend --plain
        systemctl list-units --no-legend --plain --state=activating,deactivating 'twind-failsafe@*.service'
    } | grep -o 'twind-failsafe@[^ ]*\.service' | sort -u
}

# Files and environment go. Settings, state, user and groups stay.
remove() {
    top=$DESTDIR$HOME_OF_TWIND
    if [ -e "$top/files" ]; then
        while read -r each; do
            rm -f "$DESTDIR$each"
        done <"$top/files"
        [ ! -d "$DESTDIR$SHARE/doc/twind" ] || find "$DESTDIR$SHARE/doc/twind" -depth -type d -empty -delete
        for each in man/man1 man/man8 bash-completion/completions bash-completion zsh/site-functions zsh; do
            rmdir "$DESTDIR$SHARE/$each" 2>/dev/null || :
        done
    fi
    if [ -e "$top/pyvenv.cfg" ]; then
        rm -f "$top/files"
        say "$top is a virtual environment made by hand: it stays"
    elif [ -e "$top/files" ] || [ -d "$top/versions" ]; then
        rm -rf "$top"
    fi
}

# Settings and state too, each said. User and groups stay: files elsewhere may be theirs, and the next user that is made
# would get their number. deb.sh puts this function into the package's postrm.
purge() {
    for each in /etc/twind /var/lib/twind /run/twind /var/lib/twind-stream /var/lib/private/twind-stream; do
        if [ -e "$DESTDIR$each" ] || [ -L "$DESTDIR$each" ]; then
            rm -rf "$DESTDIR$each"
            echo "removed $each"
        fi
    done
    [ -n "$DESTDIR" ] || ! getent passwd twind >/dev/null ||
        echo "user twind and groups twind-operator and twind-observe stay: files elsewhere may be theirs"
}

# ------------------------------------------------------------------------------------------- the two ways

require() {
    [ -n "$DESTDIR" ] || [ "$(id -u)" = 0 ] || fail "this needs root: sudo make $1"
    case $DESTDIR in "" | /*) ;; *) fail "DESTDIR=$DESTDIR: give a path that begins with /" ;; esac
    [ -z "$DESTDIR" ] || return 0
    case $1-$(dpkg-query -W -f '${db:Status-Status}' twind 2>/dev/null || :) in
    *- | *-not-installed | uninstall-config-files) ;;
    uninstall-*) fail "twind is here as a Debian package: sudo apt remove twind" ;;
    *) # removed, but not purged: its purge would delete the settings of what we install
        fail "twind is here as a Debian package, or its settings are: install the newer package, or copy what you need of" \
            "/etc/twind, /var/lib/twind and /var/lib/twind-stream, sudo apt purge twind, then again"
        ;;
    esac
}

# Somebody else's commands are not ours to replace.
free() {
    for each in $COMMANDS; do
        [ -L "$DESTDIR$BIN/$each" ] || [ ! -e "$DESTDIR$BIN/$each" ] ||
            fail "$DESTDIR$BIN/$each is there already, and not ours (pip?); remove it, then again"
    done
}

install_all() {
    require install
    free
    if [ -n "${WHEELS:-}" ]; then
        environment "$WHEELS"
    else
        python=$(python)
        scratch
        wheels "$SCRATCH/wheels"
        environment "$SCRATCH/wheels"
    fi
    files
    settings
    if [ -n "$DESTDIR" ]; then
        say "installed into $DESTDIR: no users made, nothing reloaded there"
    else
        register
        next
    fi
}

next() {
    cat <<TEXT

twind is installed; nothing was started, and nothing moves. What next:
  1. /etc/twind/twind.yaml          robot and ports; it is read only (mode: mirror) until you change that
  2. systemctl start twind          then: systemctl status twind, twindctl doctor
     systemctl enable twind         at every start of the machine
  3. usermod -aG twind-operator YOU then log in again: who may command (twind-observe: who may look and stop)
$SHARE/doc/twind/systemd/README.md tells of going live, several robots, sockets, CAN and real time.
TEXT
}

uninstall_all() {
    require uninstall
    [ -n "$DESTDIR" ] || stop
    remove
    [ -n "$DESTDIR" ] || reload
    if [ "${PURGE:-}" = 1 ]; then
        purge
        say "twind is removed, with its settings and state"
    else
        say "twind is removed; user twind and its groups stay, and /etc/twind, /var/lib/twind, /var/lib/twind-stream" \
            "(PURGE=1 removes these folders)"
    fi
}

case ${1:-} in
install) install_all ;;
uninstall) uninstall_all ;;
own) [ $# = 2 ] || [ $# = 3 ] || fail "own needs a folder"; "$@" ;;
wheels | environment) [ $# = 2 ] || fail "$1 needs a folder"; "$1" "$2" ;;
foreign) [ $# = 3 ] || fail "$1 needs a folder and a version of Python"; "$1" "$2" "$3" ;;
files | settings | register | stop | remove | next | version) "$1" ;;
*) fail "usage: install.sh install | uninstall; its first lines tell of the rest" ;;
esac
