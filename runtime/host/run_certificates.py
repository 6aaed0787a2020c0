"""The certificates of a run that other machines join: its links are encrypted (TLS), and both ends of each prove that
they belong to the run.

Such a run has an authority, made when it begins, whose certificate and private key stand in the run's key. By it
certificates are made, each for one role (`hierax.schemas.access`), which is its common name, and for the addresses at
which its session listens. Those of the launch and of nodes hold whatever a machine's clock says, and all are good for
nothing when the run is over, as everybody has forgotten the authority then.
"""

import ipaddress
import socket
from collections.abc import Sequence
from contextlib import suppress
from datetime import datetime, timezone

from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric.ec import SECP256R1, EllipticCurvePrivateKey, generate_private_key
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat, load_pem_private_key
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from hierax.runtime.core.errors import HieraxError

_RUN = "a run of hierax"
# RFC 5280, 4.1.2.5, has the latter where there is no good date
_FROM, _TO = datetime(1970, 1, 2, tzinfo=timezone.utc), datetime(9999, 12, 31, 23, 59, 59, tzinfo=timezone.utc)


def new_authority() -> str:
    """An authority for one run: its certificate and private key, PEM."""
    key = generate_private_key(SECP256R1())
    made = _builder(_RUN, key, _TO).add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
    return (made.sign(key, hashes.SHA256()).public_bytes(Encoding.PEM) + _private(key)).decode()


def certificates(authority: str, role: str, addresses: Sequence[str], until: datetime | None = None) -> str:
    """The certificate of an authority, as `new_authority` gives it, and one for a session of a role, with its private
    key, PEM: the session listens at some addresses (names or numbers), and it holds until a time, or for ever.

    Raises `HieraxError` if the authority is none."""
    try:
        issuer, issuer_key = x509.load_pem_x509_certificate(authority.encode()), _key_in(authority)
    except ValueError as error:
        raise HieraxError(
            f"the key of the run holds no certificate and private key that can be read: {error}"
        ) from None
    key = generate_private_key(SECP256R1())
    named = [name for address in addresses for name in _named(address).values()]
    names = x509.SubjectAlternativeName([x509.DNSName("hierax"), *named])
    usage = x509.ExtendedKeyUsage([ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH])
    builder = _builder(role, key, until or _TO).add_extension(names, critical=False)
    made = builder.add_extension(usage, critical=False).sign(issuer_key, hashes.SHA256())
    return b"".join((issuer.public_bytes(Encoding.PEM), made.public_bytes(Encoding.PEM), _private(key))).decode()


def role_of(pem: str) -> tuple[str, datetime]:
    """Whose the last of some certificates is, and until when it holds. Raises `HieraxError` if they cannot be read."""
    try:
        shown = x509.load_pem_x509_certificates(pem.encode())[-1]
        (name,) = shown.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
    except ValueError as error:
        raise HieraxError(f"the key holds no certificate that can be read: {error}") from None
    return str(name.value), shown.not_valid_after_utc


def _builder(subject: str, key: EllipticCurvePrivateKey, until: datetime) -> x509.CertificateBuilder:
    subject_name, issuer_name = (x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)]) for name in (subject, _RUN))
    builder = x509.CertificateBuilder(issuer_name, subject_name, key.public_key(), x509.random_serial_number())
    return builder.not_valid_before(_FROM).not_valid_after(until)


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
    with suppress(OSError, UnicodeError):  # the second of what can be no host's name
        for *_, (number, *_) in socket.getaddrinfo(address, None):
            names[str(number)] = x509.IPAddress(ipaddress.ip_address(number))
    return names
