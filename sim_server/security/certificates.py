"""Certificate authority and router certificate of one secured server: EC P-256, PEM."""

from datetime import datetime, timedelta, timezone

import msgspec
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

VALID_DAYS = 3650
RENEWAL_DAYS = 30
"""A router certificate that expires sooner is made anew at the next start."""
BACKDATED = timedelta(hours=1)
"""Clocks of clients may be behind."""


class CertifiedKey(msgspec.Struct, frozen=True):
    """A certificate and its private key, PEM."""

    certificate: bytes
    private_key: bytes

    def __repr__(self) -> str:
        """Show nothing of the key."""
        return "CertifiedKey()"


def make_authority(world: str, days: int = VALID_DAYS) -> CertifiedKey:
    """Make the authority of a world, which signs nothing but the certificates of its router."""
    key = ec.generate_private_key(ec.SECP256R1())
    name = _make_name(f"zensim authority of {world}")
    certificate = (
        _begin(name, name, key.public_key(), days)
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .sign(key, hashes.SHA256())
    )
    return _write(certificate, key)


def make_router_certificate(authority: CertifiedKey, days: float = VALID_DAYS) -> CertifiedKey:
    """Make the certificate of a router; the authority's follows it, for clients that pin that."""
    signer = serialization.load_pem_private_key(authority.private_key, password=None)
    issuer = x509.load_pem_x509_certificate(authority.certificate)
    if not isinstance(signer, ec.EllipticCurvePrivateKey):
        raise TypeError("the key of the authority must be an elliptic curve key")
    key = ec.generate_private_key(ec.SECP256R1())
    certificate = (
        _begin(_make_name("zensim router"), issuer.subject, key.public_key(), days)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(x509.SubjectAlternativeName([x509.DNSName("zensim")]), critical=False)
        .add_extension(x509.ExtendedKeyUsage([ExtendedKeyUsageOID.SERVER_AUTH]), critical=False)
        .sign(signer, hashes.SHA256())
    )
    own = _write(certificate, key)
    return CertifiedKey(own.certificate + authority.certificate, own.private_key)


def is_due_for_renewal(certificate: bytes) -> bool:
    """Whether a certificate (PEM) expires within `RENEWAL_DAYS`."""
    ends = x509.load_pem_x509_certificate(certificate).not_valid_after_utc
    return ends - datetime.now(timezone.utc) < timedelta(days=RENEWAL_DAYS)


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
