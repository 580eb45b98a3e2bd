"""The bus: a Zenoh session for live control and results; the only user of the Zenoh library.

The proxy's process (or `run`) opens the bus as the router on loopback; all others are clients, so
no router needs to be installed. Keys start with `mavfault/v1/{run}/`; live control is under the
verbatim chunk `@ctl`, which wildcards do not match. docs/zenoh.md lists the key space.
"""

import contextlib
import json
import logging
import os
import re
import socket
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.links.bus_users import CONFIG, USERS, credentials_folder
from mavproxy_fault.links.open_hint import describe_port_owner

DEFAULT_URL = "tcp/127.0.0.1:7447"
ROOT = "mavfault/v1"
ENCODING = "application/json"
RUN_NAME = re.compile(r"[\w.-]+", re.ASCII)
ANY_RUN = "*"  # a session that addresses all runs
OPEN_MS = 3000  # chosen: long enough for a busy router, short enough for a waiting user
LOG = logging.getLogger(__name__)

QueryHandler = Callable[[str, bytes], object]
SampleHandler = Callable[[str, bytes], None]


class Bus(contextlib.AbstractContextManager["Bus"]):
    """One session; unless it is closed (or its `with` block left), the interpreter hangs at exit.

    Callbacks run on Zenoh's threads.
    """

    def __init__(self, session: Any, url: str, run: str, *, is_router: bool = False) -> None:
        self._session = session
        self._publishers: dict[str, Any] = {}
        self._declarations: list[Any] = []
        self.url = url
        self.run = run
        self.is_router = is_router

    def __exit__(self, *raised: object) -> None:
        self.close()

    def key(self, suffix: str) -> str:
        """Return the full key of `suffix` in this run."""
        return f"{ROOT}/{self.run}/{suffix}"

    def put(self, suffix: str, payload: bytes, schema: str = "", history: int = 0) -> None:
        """Publish JSON under a suffix; a slow subscriber loses samples but never blocks the caller.

        The newest `history` samples are stored for late subscribers.
        """
        publisher = self._publishers.get(suffix)
        if publisher is None:
            publisher = self._publishers[suffix] = self._publisher(suffix, schema, history)
        publisher.put(payload)

    def _publisher(self, suffix: str, schema: str, history: int) -> Any:
        import zenoh
        import zenoh.ext

        options: dict[str, Any] = {
            "encoding": f"{ENCODING};{schema}" if schema else ENCODING,
            # The proxy's loop must not wait for a slow subscriber.
            "congestion_control": zenoh.CongestionControl.DROP,
        }
        if not history:
            return self._session.declare_publisher(self.key(suffix), **options)
        return zenoh.ext.declare_advanced_publisher(
            self._session,
            self.key(suffix),
            cache=zenoh.ext.CacheConfig(history),
            publisher_detection=True,
            **options,
        )

    def subscribe(self, suffix: str, received: SampleHandler) -> None:
        """Call `received(key, payload)` for every sample under a suffix (wildcards allowed).

        Samples stored by the publisher come first.
        """
        import zenoh.ext

        subscriber = zenoh.ext.declare_advanced_subscriber(
            self._session,
            self.key(suffix),
            lambda sample: received(str(sample.key_expr), sample.payload.to_bytes()),
            history=zenoh.ext.HistoryConfig(detect_late_publishers=True),
        )
        self._declarations.append(subscriber)

    def serve_queries(self, suffix: str, answer: QueryHandler) -> None:
        """Reply to queries under a suffix with the return value of `answer(key, payload)` as JSON.

        The text of a ConfigError is sent as an error reply.
        """

        def reply(query: Any) -> None:
            payload = query.payload.to_bytes() if query.payload is not None else b""
            try:
                value = answer(str(query.key_expr), payload)
            except ConfigError as error:
                query.reply_err(json.dumps({"error": str(error)}), encoding=ENCODING)
            except Exception:  # Zenoh would only print a bug; the client must learn of it
                LOG.exception("query %s failed", query.key_expr)
                text = "the request failed because of a bug; see the log of the replying process"
                query.reply_err(json.dumps({"error": text}), encoding=ENCODING)
            else:
                data = value if isinstance(value, bytes) else json.dumps(value)
                query.reply(query.key_expr, data, encoding=ENCODING)
            finally:
                query.drop()  # the client waits until it is freed, and a traceback may refer to it

        self._declarations.append(self._session.declare_queryable(self.key(suffix), reply))

    def query(self, suffix: str, payload: bytes = b"", timeout_s: float = 3.0) -> list[bytes]:
        """Send a query and return the replies.

        Raises
        ------
        ConfigError
            If the request was refused (with the reason), or there was no reply.
        """
        replies = []
        for reply in self._session.get(self.key(suffix), payload=payload, timeout=timeout_s):
            if reply.ok is None:
                text = reply.err.payload.to_string()
                # Refusals are JSON, Zenoh's own errors (such as a timeout) plain text.
                raise ConfigError(json.loads(text)["error"] if text[:1] == "{" else text)
            replies.append(reply.ok.payload.to_bytes())
        if not replies:
            raise ConfigError(
                f"{self.url}: no reply for {self.key(suffix)}; start a proxy or a run first"
            )
        return replies

    def declare_alive(self, component: str) -> None:
        """Declare a component alive until this bus closes."""
        token = self._session.liveliness().declare_token(self.key(f"alive/{component}"))
        self._declarations.append(token)

    def list_components(self, timeout_s: float = 2.0) -> list[str]:
        """Return the keys of all live components, of every run."""
        replies = self._session.liveliness().get(f"{ROOT}/*/alive/**", timeout=timeout_s)
        return sorted(str(reply.ok.key_expr) for reply in replies if reply.ok is not None)

    @property
    def is_connected(self) -> bool:
        """Whether this session is the router or connected to one."""
        return self.is_router or bool(self._session.info.routers_zid())

    def close(self) -> None:
        """Close the session; no callback runs afterwards."""
        for thing in [*self._declarations, *self._publishers.values()]:
            thing.undeclare()
        self._declarations, self._publishers = [], {}
        if not self._session.is_closed():
            self._session.close()


def open_bus(
    url: str | None = None, *, run: str = "live", router: bool = False, config_file: str = ""
) -> Bus:
    """Open a session as a router or as the client of one.

    Parameters
    ----------
    url : str, optional
        Zenoh endpoint; `auto` and None are `tcp/127.0.0.1:7447`. Port 0 is any free port.
    run : str
        The run's name in the key space.
    router : bool
        Listen at `url` as the router; otherwise connect to it.
    config_file : str
        A Zenoh configuration, such as TLS, users and access control, that the settings below
        extend. The default is the variable ZENOH_CONFIG; without either only programs of the same
        user are admitted (see `bus_users`).

    Raises
    ------
    ConfigError
        If the address is in use (router) or has no router (client), or if a name or the
        configuration is invalid.
    """
    if run != ANY_RUN:
        check_run_name(run)
    if url not in (None, "auto") and "/" not in url:
        raise ConfigError(f"--zenoh: {url!r} is not an address; give tcp/HOST:PORT")
    address = choose_free_port(DEFAULT_URL if url is None or url == "auto" else url)
    config_file = config_file or os.environ.get("ZENOH_CONFIG", "")
    if config_file:
        return _open_session(address, run, router, read_config(config_file))
    own = credentials_folder()
    config = read_config(str(own / CONFIG))
    if router:
        users = json.dumps(str(own / USERS))
        config.insert_json5("transport/auth/usrpwd/dictionary_file", users)
        return _open_session(address, run, router, config)
    try:
        return _open_session(address, run, router, config)
    except ConfigError:
        # Another router, such as zenohd or that of ROS 2, may not require a password.
        return _open_session(address, run, router, read_config(""))


def _open_session(address: str, run: str, router: bool, config: Any) -> Bus:
    import zenoh

    settings: dict[str, object] = {
        "mode": "router" if router else "client",
        # Nothing leaves this machine unless the user requests it: no multicast, no gossip.
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "scouting/delay": 0,
        # Stored samples are ordered by timestamp.
        "timestamping/enabled": True,
        "transport/shared_memory/enabled": False,
        # Give up soon on a peer that accepts the connection but does not respond.
        "transport/unicast/open_timeout": OPEN_MS,
        "connect/retry": {
            "period_init_ms": 100,
            "period_max_ms": 500,
            "period_increase_factor": 1.5,
        },
        "listen/endpoints": [address] if router else [],
        "connect/endpoints": [] if router else [address],
    }
    try:
        for key, value in settings.items():
            config.insert_json5(key, json.dumps(value))
        return Bus(zenoh.open(config), address, run, is_router=router)
    except zenoh.ZError as error:
        # Zenoh appends a path of its own source.
        reason = str(error).split(" at /")[0]
        raise ConfigError(
            _explain_router_failure(address, reason) if router else _explain_client_failure(address)
        ) from error
    except BaseException as error:
        # Zenoh's panic is not an Exception, and its class is known only by name.
        if type(error).__name__ != "PanicException":
            raise
        raise ConfigError(
            f"zenoh {address} cannot be opened ({error}); "
            "raise the limits of descriptors, threads or memory (ulimit -n, -u, -v)"
        ) from None


def _explain_router_failure(address: str, reason: str) -> str:
    """Explain why the router could not open; name the owner of an address in use."""
    port = address.rpartition(":")[2]
    held = (
        f": {describe_port_owner(int(port), tcp=True)}"
        if "address already in use" in reason.lower()
        else ""
    )
    return (
        f"zenoh {address} cannot be opened as the router{held} ({reason}); allowed: tcp/HOST:PORT"
        " that is free"
    )


def _explain_client_failure(address: str) -> str:
    """Explain why a client could not connect: refused, or nothing listening."""
    host, _, port = address.partition("/")[2].rpartition(":")
    with contextlib.suppress(OSError, ValueError), socket.create_connection((host, int(port)), 1.0):
        return (
            f"zenoh {address} refused the connection: it belongs to another user or requires a"
            " password or certificate; give them with --zenoh-config FILE or the variable"
            " ZENOH_CONFIG"
        )
    return (
        f"no proxy or run is at zenoh {address}; start one, such as `mavproxy-fault run --ui`, or"
        " give its address with --zenoh"
    )


def check_run_name(run: str) -> None:
    """Refuse a run name that is not valid in a key.

    Raises
    ------
    ConfigError
        If it has other characters than letters, digits, dots, hyphens and underscores.
    """
    if not RUN_NAME.fullmatch(run):
        raise ConfigError(f"--run {run!r} cannot be a key; use letters, digits, '.', '-' and '_'")


def read_config(path: str) -> Any:
    """Read a Zenoh configuration file, or return Zenoh's defaults.

    Raises
    ------
    ConfigError
        If the file cannot be read or is invalid.
    """
    import zenoh

    if not path:
        return zenoh.Config()
    try:
        return zenoh.Config.from_file(path)
    except zenoh.ZError as error:
        raise ConfigError(
            f"--zenoh-config {path}: {str(error).split(' at /')[0]}; give a JSON5 or YAML file"
        ) from None


def running_proxies(keys: Sequence[str]) -> list[str]:
    """Return the runs with a live proxy, given the keys of all live components."""
    start, end = f"{ROOT}/", "/alive/proxy"
    return sorted(key[len(start) : -len(end)] for key in keys if key.endswith(end))


def join_bus(choice: str, run: str, config_file: str = "", *, without: str) -> Bus | None:
    """Open the bus as its router, or as a client if there is one already; None for `off`.

    `choice` is an address, `off`, or `auto` (the default address): where that is another user's,
    what goes on `without` a bus is logged and None returned.

    Raises
    ------
    ConfigError
        If a given address, or one of a configuration file, cannot be used.
    """
    if choice == "off":
        return None
    try:
        return open_bus(choice, run=run, router=True, config_file=config_file)
    except ConfigError as error:
        with contextlib.suppress(ConfigError):  # another process may already be the router
            return open_bus(choice, run=run, config_file=config_file)
        if choice != "auto" or config_file:
            raise
        LOG.warning("%s: %s", without, error)
        return None


@contextlib.contextmanager
def open_run_bus(
    choice: str, run: str, component: str = "run", config_file: str = ""
) -> Iterator[Bus | None]:
    """Open the bus of a run, as `join_bus` does, and close it at the end."""
    bus = join_bus(choice, run, config_file, without="nothing is published")
    if bus is None:
        yield None
        return
    with bus:
        bus.declare_alive(component)
        yield bus


def choose_free_port(url: str) -> str:
    """Replace port 0 in `url` by a port that is free now."""
    if not url.endswith(":0"):
        return url
    with socket.socket() as probe:
        # Zenoh does not report the port it got, so choose one for it.
        probe.bind(("127.0.0.1", 0))
        return f"{url[:-1]}{probe.getsockname()[1]}"
