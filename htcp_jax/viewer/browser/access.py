"""A viser server that answers requests of its own page only, and requires a token if other machines can connect.

A browser lets every web page open a websocket to this machine; the header `Origin` names the page. It also lets a page
send requests to this machine if the page's host name resolves to it (DNS rebinding); the header `Host` contains that
name. viser checks neither header, so `Access` does.
"""

import contextlib
import hmac
import io
import secrets
import socket
from collections.abc import Callable, Iterator
from functools import partial
from http import HTTPStatus
from ipaddress import ip_address
from typing import NamedTuple
from urllib.parse import parse_qs, urlsplit

import viser
import websockets.asyncio.server
from websockets.asyncio.server import ServerConnection
from websockets.http11 import Request, Response

from htcp_jax.errors import InputError

OWN_NAMES = "localhost", "127.0.0.1", "::1"  # loopback names of every machine

# viser's page is one self-extracting file that needs no other server, but would accept another server's address in
# its own (?websocket=). It needs no event handlers in attributes, which would let HTML in a name run scripts, and no
# frame.
POLICY = (
    "default-src 'self' 'unsafe-inline' 'unsafe-eval' data: blob:; connect-src 'self' ws://{host} wss://{host} data: "
    "blob:; script-src-attr 'none'; object-src 'none'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)


class Access(NamedTuple):
    """Rule that decides which requests are answered.

    With a token, a request must contain it. Without one, a request must be addressed to this machine by one of its own
    names. A websocket is only opened for a page from this server.
    """

    names: tuple[str, ...]  # valid host names, without the port, which an SSH tunnel may change
    token: str | None

    def refusal(self, request: Request) -> str | None:
        """Return the reason why a request is refused; None if it is accepted."""
        hosts, origins = request.headers.get_all("Host"), request.headers.get_all("Origin")
        if len(hosts) != 1 or (self.token is None and _host_name(hosts[0]) not in self.names):
            return "unknown host"
        if origins not in ([], [f"http://{hosts[0]}"], [f"https://{hosts[0]}"]):
            return "foreign page"
        if not origins and "Upgrade" in request.headers:
            return "no page"
        if self.token is not None and not any(
            hmac.compare_digest(self.token.encode(), t) for t in self._given(request)
        ):
            return "use the address with the token that htcp view printed"
        return None

    def answer(self, serve_page: Callable, connection: ServerConnection, request: Request) -> Response | None:
        """Return the response to a request, the page or a refusal; None lets a websocket open.

        Args:
            serve_page: viser's function that answers a request.
            connection: The connection.
            request: The request.
        """
        if (reason := self.refusal(request)) is not None:
            return connection.respond(HTTPStatus.FORBIDDEN, f"htcp view: {reason}\n")
        if (response := serve_page(connection, request)) is not None:
            response.headers["Content-Security-Policy"] = POLICY.format(host=request.headers["Host"])
            response.headers["Referrer-Policy"] = "no-referrer"
            if self.token is not None:  # a websocket's address has no query, so it sends the token as a cookie
                response.headers["Set-Cookie"] = f"{self._cookie}{self.token}; HttpOnly; SameSite=Strict; Path=/"
        return response

    @property
    def _cookie(self) -> str:
        """Name of the cookie, different for every server, because the ports of a host share their cookies."""
        return f"htcp-view-{self.token[:6]}="

    def _given(self, request: Request) -> list[bytes]:
        """Return the tokens in a request's address and cookies."""
        cookies = (pair.strip() for line in request.headers.get_all("Cookie") for pair in line.split(";"))
        given = [pair.removeprefix(self._cookie) for pair in cookies if pair.startswith(self._cookie)]
        return [token.encode() for token in given + parse_qs(request.path.partition("?")[2]).get("token", [])]


def serve(host: str, port: int) -> tuple[viser.ViserServer, str]:
    """Start a protected viser server.

    Args:
        host: The address to listen on.
        port: The port; 0: any free port. No other port is tried if it is in use.

    Returns:
        The server, and the address of its page. The address contains a token unless only this machine can connect.

    Raises:
        InputError: If the address is not available, or if this version of viser cannot be protected.
    """
    try:
        found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
        with socket.socket(found[0][0]) as trial:  # viser would silently use the next free port
            trial.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            trial.bind(found[0][-1])
    except (OSError, OverflowError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise InputError(f"cannot listen on {host}, port {port}: {reason}; choose another port with --port") from None
    addresses = [ip_address(address[0]) for *_, address in found]
    alone = all(address.is_loopback for address in addresses)
    access = Access((*OWN_NAMES, host.lower()), None if alone else secrets.token_urlsafe())
    with silent(), _guarded(access) as guarded:
        server = viser.ViserServer(host=host, port=port, verbose=False)
    if not guarded:
        server.stop()
        raise InputError(f"htcp view cannot protect its page with viser {viser.__version__}; install viser 1.1")
    name = socket.gethostname() if addresses[0].is_unspecified else f"[{host}]" if ":" in host else host
    return server, f"http://{name}:{server.get_port()}" + ("" if alone else f"/?token={access.token}")


def silent():
    """Return a context in which viser's output to stdout is suppressed."""
    return contextlib.redirect_stdout(io.StringIO())


@contextlib.contextmanager
def _guarded(access: Access) -> Iterator[list[bool]]:
    """Apply `access` to the server that is created in the block; viser has no setting for this.

    Yields a list that is empty until a server is created by the websockets function that viser 1.1 calls.
    """
    original, guarded = websockets.asyncio.server.serve, []

    def serve_guarded(*args, process_request, **how):
        guarded.append(True)
        return original(*args, process_request=partial(access.answer, process_request), **how)

    websockets.asyncio.server.serve = serve_guarded
    try:
        yield guarded
    finally:
        websockets.asyncio.server.serve = original


def _host_name(host: str) -> str | None:
    """Return a host's name without the port; None if the host is invalid."""
    try:
        return urlsplit(f"//{host}").hostname
    except ValueError:
        return None
