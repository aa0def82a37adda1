"""Certificates of one secured server, its authority, router and clients: EC P-256, PEM."""

from collections.abc import Iterable
from datetime import datetime, timedelta, timezone

import msgspec
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

SECONDS_OF_DAY = 86_400
VALID_DAYS = 3650
RENEWAL_DAYS = 30
"""A router certificate that expires sooner is made anew at the next start."""
BACKDATED = timedelta(hours=1)
"""Clocks of clients may be behind."""
REVOKED_PASSWORDS = x509.ObjectIdentifier("2.25.212494399817416431353066206482379128533")
"""Extension of a router's certificate: digests of revoked passwords, in an OCTET STRING."""
OCTET_STRING = b"\x04\x82"
"""Tag of DER, with a length in two bytes."""


class CertifiedKey(msgspec.Struct, frozen=True):
    """A certificate and its private key, PEM."""

    certificate: bytes
    private_key: bytes

    def __repr__(self) -> str:
        """Show nothing of the key."""
        return "CertifiedKey()"


def make_authority(world: str, days: int = VALID_DAYS) -> CertifiedKey:
    """Make the authority of a world, which signs certificates of its router and its clients."""
    key = ec.generate_private_key(ec.SECP256R1())
    name = _make_name(f"zensim authority of {world}")
    certificate = (
        _begin(name, name, key.public_key(), days)
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .sign(key, hashes.SHA256())
    )
    return _write(certificate, key)


def make_router_certificate(
    authority: CertifiedKey, days: float = VALID_DAYS, revoked: Iterable[bytes] = ()
) -> CertifiedKey:
    """Make the certificate of a router; the authority's follows it, for clients that pin that.

    Args:
        authority: That signs it.
        days: Validity.
        revoked: Digests of revoked passwords; see `hash_revoked_password`.
    """
    digests = b"".join(revoked)
    extension = x509.UnrecognizedExtension(
        REVOKED_PASSWORDS, OCTET_STRING + len(digests).to_bytes(2, "big") + digests
    )
    own = _sign(authority, "zensim router", days, ExtendedKeyUsageOID.SERVER_AUTH, extension)
    return CertifiedKey(own.certificate + authority.certificate, own.private_key)


def make_client_certificate(authority: CertifiedKey, user: str, valid_s: float) -> CertifiedKey:
    """Make the certificate of a user, whose common name is the user's; no router can use it."""
    return _sign(authority, user, valid_s / SECONDS_OF_DAY, ExtendedKeyUsageOID.CLIENT_AUTH)


def has_revoked(certificate: bytes, digests: Iterable[bytes]) -> bool:
    """Whether a router's certificate (PEM) lists exactly these digests of revoked passwords."""
    try:
        found = x509.load_pem_x509_certificate(certificate).extensions.get_extension_for_oid(
            REVOKED_PASSWORDS
        )
    except x509.ExtensionNotFound:
        return False
    value = found.value
    listed = value.value[4:] if isinstance(value, x509.UnrecognizedExtension) else b""
    return listed == b"".join(digests)


def _sign(
    authority: CertifiedKey,
    name: str,
    days: float,
    usage: x509.ObjectIdentifier,
    *extensions: x509.ExtensionType,
) -> CertifiedKey:
    signer = serialization.load_pem_private_key(authority.private_key, password=None)
    issuer = x509.load_pem_x509_certificate(authority.certificate)
    if not isinstance(signer, ec.EllipticCurvePrivateKey):
        raise TypeError("the key of the authority must be an elliptic curve key")
    key = ec.generate_private_key(ec.SECP256R1())
    builder = (
        _begin(_make_name(name), issuer.subject, key.public_key(), days)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(x509.SubjectAlternativeName([x509.DNSName("zensim")]), critical=False)
        .add_extension(x509.ExtendedKeyUsage([usage]), critical=False)
    )
    for extension in extensions:
        builder = builder.add_extension(extension, critical=False)
    return _write(builder.sign(signer, hashes.SHA256()), key)


def find_renewal_s(certificate: bytes) -> float:
    """Find when a certificate (PEM) is due for renewal, `RENEWAL_DAYS` before it expires.

    Returns:
        Seconds since the epoch.
    """
    ends = x509.load_pem_x509_certificate(certificate).not_valid_after_utc
    return (ends - timedelta(days=RENEWAL_DAYS)).timestamp()


def _begin(
    subject: x509.Name, issuer: x509.Name, key: ec.EllipticCurvePublicKey, days: float
) -> x509.CertificateBuilder:
    now = datetime.now(timezone.utc)
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key)
        .serial_number(x509.random_serial_number())
        .not_valid_before(min(now, now + timedelta(days=days)) - BACKDATED)
        .not_valid_after(now + timedelta(days=days))
    )


def _make_name(text: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, text)])


def _write(certificate: x509.Certificate, key: ec.EllipticCurvePrivateKey) -> CertifiedKey:
    return CertifiedKey(
        certificate.public_bytes(serialization.Encoding.PEM),
        key.private_bytes(
            serialization.Encoding.PEM,
            serialization.PrivateFormat.PKCS8,
            serialization.NoEncryption(),
        ),
    )
