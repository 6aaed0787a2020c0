"""The certificates of a run that other machines join: its links are encrypted (TLS), and both ends of each prove that
they belong to the run.

Such a run has an authority, made when it begins, whose certificate and private key stand in the run's key. Whoever has
the key makes a certificate for each of its sessions by it, for the addresses at which that listens. They hold whatever
a machine's clock says, and are good for nothing when the run is over, as everybody has forgotten the authority then.
"""

import ipaddress
import socket
from collections.abc import Sequence
from contextlib import suppress
from datetime import datetime, timezone
from typing import NamedTuple

from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric.ec import SECP256R1, EllipticCurvePrivateKey, generate_private_key
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat, load_pem_private_key
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from hierax.runtime.core.errors import HieraxError

_RUN, _SESSION = "a run of hierax", "hierax"
# RFC 5280, 4.1.2.5, has the latter where there is no good date
_FROM, _TO = datetime(1970, 1, 2, tzinfo=timezone.utc), datetime(9999, 12, 31, 23, 59, 59, tzinfo=timezone.utc)


class Certificate(NamedTuple):
    """What a session shows, and what those must show that it links to; PEM."""

    authority: bytes
    shown: bytes
    private_key: bytes


def new_authority() -> str:
    """An authority for one run: its certificate and private key, PEM."""
    key = generate_private_key(SECP256R1())
    made = _builder(_RUN, _RUN, key).add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
    return (made.sign(key, hashes.SHA256()).public_bytes(Encoding.PEM) + _private(key)).decode()


def certificate(authority: str, addresses: Sequence[str]) -> Certificate:
    """One for a session that listens at some addresses (names or numbers), by an authority as `new_authority` gives it.
    Raises `HieraxError` if that is none."""
    try:
        issuer, issuer_key = x509.load_pem_x509_certificate(authority.encode()), _key_in(authority)
    except ValueError as error:
        raise HieraxError(
            f"the key of the run holds no certificate and private key that can be read: {error}"
        ) from None
    key = generate_private_key(SECP256R1())
    named = [name for address in addresses for name in _named(address).values()]
    names = x509.SubjectAlternativeName([x509.DNSName(_SESSION), *named])
    usage = x509.ExtendedKeyUsage([ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH])
    made = _builder(_SESSION, _RUN, key).add_extension(names, critical=False).add_extension(usage, critical=False)
    shown = made.sign(issuer_key, hashes.SHA256()).public_bytes(Encoding.PEM)
    return Certificate(issuer.public_bytes(Encoding.PEM), shown, _private(key))


def _builder(subject: str, issuer: str, key: EllipticCurvePrivateKey) -> x509.CertificateBuilder:
    subject_name, issuer_name = (
        x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)]) for name in (subject, issuer)
    )
    builder = x509.CertificateBuilder(issuer_name, subject_name, key.public_key(), x509.random_serial_number())
    return builder.not_valid_before(_FROM).not_valid_after(_TO)


def _private(key: EllipticCurvePrivateKey) -> bytes:
    return key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())


def _key_in(authority: str) -> EllipticCurvePrivateKey:
    key = load_pem_private_key(authority.encode(), None)
    if not isinstance(key, EllipticCurvePrivateKey):
        raise ValueError("its private key is of another kind")
    return key


def _named(address: str) -> dict[str, x509.GeneralName]:
    """An address as a certificate has it; of one that is given by name its numbers, too, since gossip tells those."""
    try:
        return {address: x509.IPAddress(ipaddress.ip_address(address))}
    except ValueError:
        names: dict[str, x509.GeneralName] = {address: x509.DNSName(address)}
    with suppress(OSError):
        for *_, (number, *_) in socket.getaddrinfo(address, None):
            names[str(number)] = x509.IPAddress(ipaddress.ip_address(number))
    return names
