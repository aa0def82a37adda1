"""SHA-256 without OpenSSL."""

import hashlib
import subprocess
import sys

import pytest

from zensim.proto.sha256 import sha256


@pytest.mark.parametrize("data", [b"", b"abc", bytes(1000)])
def test_digest_is_that_of_hashlib(data: bytes) -> None:
    added = sha256(b"")
    added.update(data)

    assert sha256(data).digest() == added.digest() == hashlib.sha256(data).digest()
    assert sha256(data).hexdigest() == hashlib.sha256(data).hexdigest()


def test_openssl_is_not_loaded() -> None:
    text = "import sys, zensim.proto.sha256; print('_hashlib' in sys.modules)"

    done = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, check=True)

    assert done.stdout == "False\n"
