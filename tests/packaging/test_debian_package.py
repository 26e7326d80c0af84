"""The Debian package, and `make install`, on a copy of this machine: what they bring, keep and leave behind.

The copy has no network. Wheels of what twind needs are fetched before, or named: TWIND_WHEELS=FOLDER.
"""

import gzip
import re
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support import built_package as built
from tests.support import machine_overlay as overlay
from tests.support.stand_in_wheels import wheel
from tests.support.unit_file_parser import CLIENTS, SERVICES, SOCKETS, SYSTEMD
from twind.version import __version__

ROOT = SYSTEMD.parent
# Whose files a user or a package changes by being there at all.
DATABASES = re.compile(
    r"/(etc/(passwd|group|shadow|gshadow)-?|var/lib/dpkg/.*|var/cache/man(/.*)?|var/log/dpkg.log|etc/\.pwd\.lock)"
)
# The daemon as its unit starts it, without a service manager.
AS_SERVICE = (
    "setpriv --reuid twind --regid twind --init-groups env -i PATH=/usr/bin HOME=/var/lib/twind "
    "XDG_CONFIG_HOME=/etc XDG_RUNTIME_DIR=/run STATE_DIRECTORY=/tmp/state "
)
MANUALS = """
for each in man/man1/twindctl.1 man/man8/twind.8 bash-completion/completions/twindctl zsh/{zsh}/_twindctl; do
    test -s {share}/$each
done
"""
TALK = f"""
mkdir /tmp/state
{AS_SERVICE} /opt/twind/bin/twind --mode sim > /tmp/log 2>&1 &
daemon=$!
until twindctl status > /tmp/status 2>&1; do
    kill -0 $daemon || {{ cat /tmp/log; exit 1; }}
    sleep 0.1
done
stat -c 'socket %U %G %a %n' /run/twind/*.sock
cat /tmp/status
kill $daemon
wait $daemon
"""


@pytest.fixture(scope="module")
def wheels(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with all wheels."""
    overlay.require()
    return built.wheels(built.shared(tmp_path_factory))


@pytest.fixture(scope="module")
def package(wheels: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The package, built."""
    return built.package(built.shared(tmp_path_factory))


@pytest.fixture(scope="module")
def debian() -> None:
    """A machine whose package manager may install it."""
    built.require_debian()


def left(ran: overlay.Ran) -> set[str]:
    """Differences from the machine as it was, data bases of users and packages aside."""
    return {path for path in ran.left if not DATABASES.fullmatch(path) and not path.startswith("/tmp/")}


@pytest.fixture(scope="module")
def unpacked(package: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    folder = tmp_path_factory.mktemp("unpacked")
    subprocess.run(["dpkg-deb", "--raw-extract", package, folder], check=True)
    yield folder
    shutil.rmtree(folder)


@pytest.mark.slow
def test_the_same_sources_give_the_same_package(package: Path, wheels: Path, tmp_path: Path) -> None:
    assert built.build(tmp_path, wheels).read_bytes() == package.read_bytes()


@pytest.mark.slow
def test_the_package_is_as_packages_are(package: Path, unpacked: Path) -> None:
    control = dict(
        line.split(": ", 1)
        for line in (unpacked / "DEBIAN/control").read_text().splitlines()
        if line[0] != " "
    )
    assert control["Version"] == __version__
    assert package.name == f"twind_{__version__}_{control['Architecture']}.deb"
    assert "@" not in control["Depends"]
    assert re.search(r"python3 \(>= 3\.\d+\), python3 \(<< 3\.\d+\)", control["Depends"])
    owners = subprocess.run(["dpkg-deb", "-c", package], capture_output=True, text=True, check=True).stdout
    assert {line.split()[1] for line in owners.splitlines()} == {"root/root"}
    files = {path for path in unpacked.rglob("*") if path.is_file() and "DEBIAN" not in path.parts}
    for path in files:
        assert (
            path.stat().st_mode & 0o777 == (0o755 if path.name == "install.sh" else 0o644)
            or path.is_symlink()
        )
    conffiles = set((unpacked / "DEBIAN/conffiles").read_text().split())
    assert conffiles == {f"/{path.relative_to(unpacked)}" for path in files if "etc" in path.parts}
    subprocess.run(["md5sum", "--quiet", "-c", "DEBIAN/md5sums"], cwd=unpacked, check=True)
    changes = gzip.decompress((unpacked / "usr/share/doc/twind/changelog.gz").read_bytes()).decode()
    assert changes.startswith(f"twind ({__version__}) ")
    for name in ("preinst", "postinst", "prerm", "postrm"):
        script = unpacked / "DEBIAN" / name
        assert script.stat().st_mode & 0o777 == 0o755
        subprocess.run(["sh", "-n", script], check=True)


@pytest.mark.slow
@pytest.mark.usefixtures("debian")
def test_the_package_installs_without_a_network_runs_and_goes_without_a_trace(
    package: Path, tmp_path: Path
) -> None:
    ran = overlay.run(
        tmp_path,
        f"""
        dpkg -i {package}
        twind --version
        id -nG twind
        {TALK}
        {MANUALS.format(share="/usr/share", zsh="vendor-completions")}
        echo '# mine' >> /etc/twind/twind.yaml
        mkdir -p /var/lib/twind/calibration
        dpkg -i {package}
        echo "again: $(tail -n 1 /etc/twind/twind.yaml)"
        dpkg -r twind
        test ! -e /opt/twind && test ! -e /usr/bin/twind
        echo "removed: $(tail -n 1 /etc/twind/twind.yaml) $(ls /var/lib/twind)"
        dpkg -P twind
        test ! -e /etc/twind && test ! -e /var/lib/twind
        id -nG twind | sed 's/^/stays: /'
        """,
    )
    assert f"twind {__version__}\n" in ran.output
    assert "nothing was started, and nothing moves" in ran.output
    assert ran.output.count("nothing was started") == 1  # not again at the second time
    assert {"twind", "dialout", "twind-operator", "twind-observe"} <= set(ran.output.split())
    assert "socket twind twind-operator 660 /run/twind/control.sock" in ran.output
    assert "socket twind twind-observe 660 /run/twind/observe.sock" in ran.output
    assert "again: # mine" in ran.output
    assert "removed: # mine calibration" in ran.output
    assert "removed /var/lib/twind\n" in ran.output
    assert "user twind and groups twind-operator and twind-observe stay" in ran.output
    assert "stays: twind" in ran.output  # files elsewhere may be the user's
    assert left(ran) == set()


@pytest.mark.slow
@pytest.mark.usefixtures("debian")
def test_package_and_make_install_do_not_stand_in_each_others_way(tmp_path: Path) -> None:
    """The installed program does not matter here: a wheel with one command."""
    overlay.require()
    wheels = wheel(tmp_path / "wheels", __version__)
    package = built.build(tmp_path / "package", wheels)
    make = f"make -s -C {ROOT}"
    ran = overlay.run(
        tmp_path,
        f"""
        {make} install
        if dpkg -i {package}; then exit 1; fi
        twind --version
        {make} uninstall PURGE=1
        dpkg -i {package}
        if {make} install; then exit 1; fi
        dpkg -P twind
        """,
        {"WHEELS": str(wheels)},
    )
    assert "installed by `make install`" in ran.output
    assert "twind is here as a Debian package" in ran.output
    assert left(ran) == set()


@pytest.mark.slow
@pytest.mark.usefixtures("debian")
def test_the_purge_of_a_removed_package_leaves_an_installation_made_since(tmp_path: Path) -> None:
    """`make install` refuses between removal and purge; one that did not is kept by the purge."""
    overlay.require()
    package = built.build(tmp_path / "package", wheel(tmp_path / "wheels", __version__))
    ran = overlay.run(
        tmp_path,
        f"""
        dpkg -i {package}
        dpkg -r twind
        if make -s -C {ROOT} install; then exit 1; fi
        test ! -e /opt/twind
        mkdir -p /opt/twind /var/lib/twind/calibration
        touch /opt/twind/files /var/lib/twind/calibration/h24.yaml /etc/twind/robots/mine.yaml
        dpkg -P twind
        id -nG twind
        rm -r /opt/twind
        """,
        {"WHEELS": str(tmp_path / "wheels")},
    )
    assert "copy what you need of /etc/twind" in ran.output
    assert "another installation is in /opt/twind" in ran.output
    assert left(ran) == {"/var/lib/twind/calibration/h24.yaml", "/etc/twind/robots/mine.yaml"}


def test_a_package_whose_purge_would_be_empty_is_not_built(tmp_path: Path) -> None:
    """The package's script calls a function that is taken from the installer."""
    packaging = tmp_path / "packaging"
    packaging.mkdir()
    (tmp_path / "twind").mkdir()
    shutil.copy(ROOT / "twind/version.py", tmp_path / "twind")
    shutil.copy(ROOT / "packaging/deb.sh", packaging)
    installer = (ROOT / "packaging/install.sh").read_text()
    (packaging / "install.sh").write_text(installer.replace("purge() {", "purge () {"))
    done = subprocess.run([packaging / "deb.sh", tmp_path], capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "no purge() in" in done.stderr


@pytest.mark.slow
def test_make_install_does_the_same(wheels: Path, tmp_path: Path) -> None:
    make = f"make -s -C {ROOT}"
    ran = overlay.run(
        tmp_path,
        f"""
        {make} install
        {TALK}
        {MANUALS.format(share="/usr/local/share", zsh="site-functions")}
        echo '# mine' >> /etc/twind/twind.yaml
        {make} install
        echo "again: $(tail -n 1 /etc/twind/twind.yaml)"
        ls /usr/local/lib/systemd/system
        mkdir -p /etc/systemd/system/multi-user.target.wants
        ln -s /usr/local/lib/systemd/system/twind.service /etc/systemd/system/multi-user.target.wants/
        {make} uninstall
        """,
        {"WHEELS": str(wheels)},
    )
    assert "socket twind twind-operator 660 /run/twind/control.sock" in ran.output
    assert "again: # mine" in ran.output
    assert {*SERVICES, *CLIENTS, *SOCKETS} <= set(ran.output.split())
    kept = {"twind.yaml", "robots/example.yaml", "robots/example.xml"}
    assert left(ran) == {f"/etc/twind/{name}" for name in kept}


@pytest.mark.slow
def test_without_root_the_installer_names_the_remedy(wheels: Path, tmp_path: Path) -> None:
    command = f"setpriv --reuid 65534 --regid 65534 --clear-groups {ROOT}/packaging/install.sh install"
    ran = overlay.run(tmp_path, command, {"WHEELS": str(wheels)}, fails=True)
    assert "this needs root: sudo make install" in ran.output
    assert left(ran) == set()
