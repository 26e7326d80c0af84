"""An authority and certificates of its own, made by the `openssl` command, good for a day on this machine."""

import shutil
import subprocess
from pathlib import Path

import pytest

HERE = "subjectAltName=DNS:localhost,IP:127.0.0.1"


class Authority:
    """Signs certificates into `folder`. Skips the test where there is no openssl."""

    def __init__(self, folder: Path) -> None:
        if shutil.which("openssl") is None:
            pytest.skip("no openssl here: it makes the certificates")
        folder.mkdir()
        self._folder = folder
        self.certificate = folder / "ca.pem"
        self._key = folder / "ca.key"
        usage = ("-addext", "basicConstraints=critical,CA:TRUE", "-addext", "keyUsage=critical,keyCertSign")
        self._openssl(
            *("req", "-x509", "-days", "1", "-subj", "/CN=authority", *usage, *self._new(self._key)),
            *("-out", self.certificate),
        )

    def sign(self, name: str) -> tuple[Path, Path]:
        """Certificate and key of who is called `name`, on this machine."""
        key, request, certificate, extensions = (
            self._folder / f"{name}.{kind}" for kind in ("key", "csr", "pem", "ext")
        )
        extensions.write_text(HERE)
        self._openssl("req", "-subj", f"/CN={name}", *self._new(key), "-out", request)
        authority = ("-CA", self.certificate, "-CAkey", self._key, "-CAcreateserial", "-extfile", extensions)
        self._openssl("x509", "-req", "-days", "1", "-in", request, *authority, "-out", certificate)
        return certificate, key

    def _new(self, key: Path) -> tuple[str | Path, ...]:
        return ("-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes", "-keyout", key)

    def _openssl(self, *words: str | Path) -> None:
        subprocess.run(["openssl", *words], check=True, capture_output=True)
