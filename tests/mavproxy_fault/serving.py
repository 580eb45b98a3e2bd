"""A proxy's loop over links, in a thread of the test process."""

import contextlib
import threading
from collections.abc import Iterator, Sequence

from mavproxy_fault.app.proxy_command import link_roles
from mavproxy_fault.app.recorder import Recorder
from mavproxy_fault.app.server import Server
from mavproxy_fault.links.link import Link
from mavproxy_fault.proxy.capture_buffer import CaptureBuffer
from mavproxy_fault.proxy.core import Core
from mavproxy_fault.proxy.engine import Engine

TIMEOUT_S = 30.0  # on a busy machine


@contextlib.contextmanager
def serving(
    links: Sequence[Link],
    engine: Engine | None = None,
    tape: CaptureBuffer | None = None,
    recorder: Recorder | None = None,
) -> Iterator[Server]:
    core = Core(link_roles(links), engine, tape=tape)
    running = Server(links, core, tape=tape, recorder=recorder)
    loop = threading.Thread(target=running.run)
    loop.start()
    try:
        yield running
    finally:
        running.stop()
        loop.join(TIMEOUT_S)
        for link in links:
            link.close()
