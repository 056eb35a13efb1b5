"""Where webhooks may go: never into this machine or its network, unless a setting names the host.

The name is resolved once for every attempt, every address it has is judged, and the connection goes
to an address that was judged: a name that points elsewhere a moment later changes nothing.
"""

from __future__ import annotations

import asyncio
import ipaddress
import socket
from collections.abc import Awaitable, Callable, Iterable

import httpx

from matiere.errors import Fault, MatiereError, SceneValidationError

MAX_URL = 2000
Address = ipaddress.IPv4Address | ipaddress.IPv6Address
Resolver = Callable[[str, int], Awaitable[list[str]]]
# What the registries do not mark: the metadata address of a cloud, and addresses that carry an IPv4
# address inside and are turned into it on the way (6to4, Teredo, NAT64, its local use).
_MORE = tuple(
    map(
        ipaddress.ip_network,
        ("168.63.129.16/32", "192.88.99.0/24", "2002::/16", "2001::/32",
         "64:ff9b::/96", "64:ff9b:1::/48", "fec0::/10", "::/96"),
    )
)  # fmt: skip


class AddressRefused(MatiereError):
    """A webhook points where none may go."""

    default_code = "address_refused"


async def resolve(host: str, port: int) -> list[str]:
    """Return the addresses of a name. Raises OSError."""
    loop = asyncio.get_running_loop()
    found = await loop.getaddrinfo(host, port, type=socket.SOCK_STREAM)
    return list(dict.fromkeys(str(entry[4][0]) for entry in found))


def is_public(text: str) -> bool:
    """Tell whether an address is one of the public Internet, whatever it is written as."""
    address: Address = ipaddress.ip_address(text)
    if isinstance(address, ipaddress.IPv6Address) and address.ipv4_mapped:
        address = address.ipv4_mapped
    return (
        address.is_global
        and not (address.is_multicast or address.is_reserved or address.is_unspecified)
        and not any(address in network for network in _MORE)
    )


class Guard:
    """Judges the addresses of webhooks."""

    def __init__(
        self, *, hosts: Iterable[str] = (), http: bool = False, resolver: Resolver = resolve
    ) -> None:
        """Allow `hosts` (names or addresses as they stand in the URL) wherever they lead.

        `http`: allow addresses without TLS too.
        """
        self._hosts = frozenset(host.lower() for host in hosts)
        self._schemes = ("https", "http") if http else ("https",)
        self._resolve = resolver

    def check(self, text: str) -> None:
        """Raise `SceneValidationError` for a URL that no attempt would be made at."""
        try:
            url = self._parsed(text)
            literal = _literal(_host(url))
            if literal is not None and not self._allowed(url) and not is_public(literal):
                raise AddressRefused(f"{literal} is not an address of the public Internet")
        except AddressRefused as error:
            raise SceneValidationError([Fault("/url", "address_refused", str(error))]) from None

    async def target(self, text: str) -> tuple[httpx.URL, str]:
        """Return the URL to connect to, its host an address that was judged, and the host's name.

        Raises `AddressRefused` and OSError.
        """
        url = self._parsed(text)
        host = _host(url)
        port = url.port or {"https": 443, "http": 80}[url.scheme]
        found = await self._resolve(host, port)
        if not found:
            raise AddressRefused(f"{host} has no address")
        if not self._allowed(url):
            for address in found:  # one that is inside is reason enough
                if not is_public(address):
                    raise AddressRefused(f"{host} leads to {address}, which is not public")
        return url.copy_with(host=found[0]), host

    def _allowed(self, url: httpx.URL) -> bool:
        return _host(url) in self._hosts

    def _parsed(self, text: str) -> httpx.URL:
        if len(text) > MAX_URL or not text.isascii() or not text.isprintable() or " " in text:
            raise AddressRefused(f"a URL has at most {MAX_URL} printable ASCII characters")
        try:
            url = httpx.URL(text)
        except httpx.InvalidURL:
            raise AddressRefused("this is no URL") from None
        if url.scheme not in self._schemes or not url.host:
            raise AddressRefused(f"the URL must begin with {' or '.join(self._schemes)}://host")
        if url.userinfo or url.fragment:
            raise AddressRefused("the URL may hold no user, password or fragment")
        if url.port is not None and not 1 <= url.port <= 65535:
            raise AddressRefused("a port is 1 to 65535")
        return url


def _host(url: httpx.URL) -> str:
    return url.raw_host.decode("ascii").lower().strip("[]")


def _literal(host: str) -> str | None:
    """Return the address that a host is written as (127.1 and 0x7f000001 too), None for a name."""
    try:
        return str(ipaddress.ip_address(host))
    except ValueError:
        pass
    try:
        return socket.inet_ntoa(socket.inet_aton(host))
    except OSError:
        return None
