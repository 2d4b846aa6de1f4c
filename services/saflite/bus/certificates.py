"""Certificates of one farm's own authority: ECDSA on P-256, X.509 v3 (RFC 5280), told apart by the common name."""

from __future__ import annotations

import ipaddress
from collections.abc import Sequence
from datetime import datetime, timedelta
from typing import NamedTuple

from cryptography import x509
from cryptography.exceptions import UnsupportedAlgorithm
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from saflite.contract.errors import Refused

COMMON_NAME_CHARS = 47  # of a name: X.509 has room for 64, and `~` and 16 digits follow
CLOCK_SKEW = timedelta(hours=1)  # a machine whose clock is behind can use a new certificate at once


class Pair(NamedTuple):
    """A private key and its certificate, both as PEM."""

    key: bytes
    certificate: bytes


def make_authority(now: datetime, days: int) -> Pair:
    """Return a new authority, good for `days`."""
    key = ec.generate_private_key(ec.SECP256R1())
    name = _name("SaFliTe Farm authority")
    builder = (
        _builder(now, now + timedelta(days=days)).subject_name(name).issuer_name(name).public_key(key.public_key())
    )
    usage = x509.KeyUsage(
        digital_signature=False,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        key_cert_sign=True,
        crl_sign=True,
        encipher_only=False,
        decipher_only=False,
    )
    builder = builder.add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
    builder = builder.add_extension(usage, critical=True)
    return _pair(key, builder.sign(key, hashes.SHA256()))


def new_common_name(name: str) -> str:
    """Return a common name that no other certificate of somebody has: `NAME~16 random digits`."""
    return f"{name[:COMMON_NAME_CHARS]}~{x509.random_serial_number() % 2**64:016x}"


def make_certificate(
    authority: Pair, common_name: str, now: datetime, until: datetime, hosts: Sequence[str] = ()
) -> Pair:
    """Return a certificate of `common_name` signed by the authority; with `hosts` (names, addresses) one to serve with.

    Raises:
        Refused: the authority's key or certificate is damaged.
    """
    signer, issuer = _signer(authority)
    key = ec.generate_private_key(ec.SECP256R1())
    usage = ExtendedKeyUsageOID.SERVER_AUTH if hosts else ExtendedKeyUsageOID.CLIENT_AUTH
    builder = _builder(now, until).subject_name(_name(common_name)).issuer_name(issuer.subject)
    builder = builder.public_key(key.public_key())
    builder = builder.add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
    builder = builder.add_extension(x509.ExtendedKeyUsage([usage]), critical=False)
    alternative = x509.SubjectAlternativeName([_alternative(host) for host in hosts or (common_name,)])
    builder = builder.add_extension(alternative, critical=False)
    return _pair(key, builder.sign(signer, hashes.SHA256()))


def validity(certificate: bytes) -> tuple[datetime, datetime]:
    """Return from when until when a certificate is good; raises Refused if it is none."""
    try:
        loaded = x509.load_pem_x509_certificate(certificate)
        return loaded.not_valid_before_utc, loaded.not_valid_after_utc
    except (ValueError, x509.InvalidVersion, UnsupportedAlgorithm) as fault:
        raise Refused("certificate", expected="an X.509 certificate as PEM", got=str(fault)) from fault


def _signer(authority: Pair) -> tuple[ec.EllipticCurvePrivateKey, x509.Certificate]:
    try:
        key = serialization.load_pem_private_key(authority.key, None)
        certificate = x509.load_pem_x509_certificate(authority.certificate)
    except (ValueError, TypeError, x509.InvalidVersion, UnsupportedAlgorithm) as fault:
        raise Refused("authority", expected="its key and certificate as PEM", got=str(fault)) from fault
    if not isinstance(key, ec.EllipticCurvePrivateKey):
        raise Refused("authority", expected="an ECDSA key", got=type(key).__name__)
    return key, certificate


def _builder(now: datetime, until: datetime) -> x509.CertificateBuilder:
    builder = x509.CertificateBuilder().serial_number(x509.random_serial_number())
    return builder.not_valid_before(now - CLOCK_SKEW).not_valid_after(until)


def _pair(key: ec.EllipticCurvePrivateKey, certificate: x509.Certificate) -> Pair:
    private = key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )
    return Pair(private, certificate.public_bytes(serialization.Encoding.PEM))


def _name(common_name: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, common_name)])


def _alternative(host: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(host))
    except ValueError:
        return x509.DNSName(host)
