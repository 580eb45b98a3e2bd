"""Another user of the machine calls every route of the live page, in many spellings.

    python tests/hardening/stranger.py

Needs root and `setpriv`. The routes are listed from the page itself. Each call goes over a socket
of user 65534, without a token and with guessed ones; all must be answered 403, or 400 where the
request is no HTTP. At the end the owner, and the stranger with the token, must be answered 200.
"""

import base64
import json
import os
import socket
import subprocess
import sys
from collections import Counter
from itertools import product

STRANGER = ["setpriv", "--reuid=65534", "--regid=65534", "--clear-groups", "/usr/bin/python3"]
METHODS = ("GET", "HEAD", "POST", "PUT", "DELETE", "OPTIONS", "PATCH", "TRACE")
HEADERS = (
    "", "X-Token: guess\r\n", "X-Forwarded-For: 127.0.0.1\r\nForwarded: for=127.0.0.1\r\n",
    "Origin: http://{host}\r\nCookie: token=x\r\n", "Authorization: Bearer x\r\n",
)  # fmt: skip


def spellings(path: str, host: str) -> list[str]:
    """The path as it is, and as a careless check might miss it."""
    return [
        path, "//" + path.lstrip("/"), path + "/", path + "?token=", path + "?token=%00",
        path.replace("/api", "/./api"), "/assets/.." + path, f"http://{host}{path}",
        path.upper(), path.replace("a", "%61"),
    ]  # fmt: skip


def status(port: int, request: str) -> str:
    """Send one request and return the status of the answer."""
    with socket.create_connection(("127.0.0.1", port), timeout=5) as page:
        page.sendall(request.encode())
        return page.recv(4096)[9:12].decode(errors="replace")


def call_routes(port: int, routes: list[str], token: str) -> Counter[str]:
    """Call every route as this process's user; print what was not refused."""
    host, found = f"127.0.0.1:{port}", Counter[str]()
    key = base64.b64encode(os.urandom(16)).decode()
    upgrade = "Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
    upgrade += f"Sec-WebSocket-Key: {key}\r\n"
    for route in routes:
        path = route.replace("{name}", "page.js").replace("{what:path}", "schedule/stop")
        requests = [
            f"{method} {one} HTTP/1.1\r\nHost: {host}\r\n{more.format(host=host)}"
            "Connection: close\r\nContent-Length: 0\r\n\r\n"
            for one, (method, more) in product(spellings(path, host), product(METHODS, HEADERS))
            if method == "GET" or not more
        ]
        requests += [f"GET {path}{end} HTTP/1.1\r\nHost: {host}\r\n{upgrade}\r\n"
                     for end in ("", "?token=", "?token=guess")]  # fmt: skip
        for request in requests:
            answer = status(port, request)
            found[answer] += 1
            if answer not in ("403", "400"):
                print("not refused:", answer, repr(request), flush=True)
    allowed = f"GET /api/catalogue HTTP/1.1\r\nHost: {host}\r\nX-Token: {token}\r\n\r\n"
    found["with token: " + status(port, allowed)] += 1
    return found


def main() -> int:
    """Serve the page and let a stranger call it; 1 if a call was answered."""
    from analysis.web.access_control import AccessControl
    from analysis.web.feed import Feed
    from analysis.web.page_server import serve_page
    from analysis.web.routes import LivePage
    from analysis.web.run_source import RunSource
    from analysis.web.sequence_folder import SequenceFolder

    feed, unused = Feed(), AccessControl("", frozenset(), frozenset())
    page = LivePage(feed, RunSource(feed, None), unused, SequenceFolder(None), True)
    routes = [route.path for route in page.app.routes]  # type: ignore[attr-defined]
    with serve_page("tcp/127.0.0.1:0", port=0) as address:
        port, token = int(address.split(":")[2].partition("/")[0]), address.partition("token=")[2]
        words = json.dumps([port, routes, token])
        with open(__file__) as script:
            text = script.read()
        done = subprocess.run([*STRANGER, "-c", text, words], capture_output=True, text=True)
        print(done.stdout + done.stderr, end="")
        own = f"GET /api/catalogue HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\n\r\n"
        owner = status(port, own)
    print(f"the owner without a token: {owner}")
    found = json.loads(done.stdout.splitlines()[-1])
    return int(owner != "200" or not found.keys() <= {"403", "400", "with token: 200"})


if __name__ == "__main__":
    if len(sys.argv) > 1:
        print(json.dumps(call_routes(*json.loads(sys.argv[1]))))
    else:
        sys.exit(main())
