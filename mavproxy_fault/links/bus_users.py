"""Who may join the bus: by default only programs of the user who opened it.

A loopback port is open to every user of the machine, and whoever joins the bus may stop a vehicle's
traffic. So the router asks for a name and a password, which lie in a file that only its user can
read. Any Zenoh program of that user joins with this file as its configuration.
"""

import contextlib
import json
import os
import secrets
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.numerics.code_cache import is_usable, user_number

CONFIG, USERS = "config.json5", "users.txt"


def credentials_folder() -> Path:
    """The folder with the configuration and the list of users, made at the first use.

    Raises
    ------
    ConfigError
        If there is no place to keep them.
    """
    for place in _candidate_folders():
        if is_usable(place):
            return _create_credentials(place / "zenoh")
    raise ConfigError(
        "--zenoh: no folder to keep the bus's password in; set XDG_STATE_HOME to one that can be"
        " written to, give --zenoh-config FILE, or --zenoh off"
    )


def _candidate_folders() -> Iterator[Path]:
    home = os.environ.get("XDG_STATE_HOME")
    if home is None:
        with contextlib.suppress(RuntimeError):  # a user without a name has no home either
            home = str(Path.home() / ".local" / "state")
    if home is not None:
        yield Path(home) / "mavproxy-fault"
    # Without a home, or a read-only one: a folder that only this user can write to.
    yield Path(os.environ.get("TMPDIR", "/tmp")) / f"mavproxy-fault-{user_number()}"


def _create_credentials(folder: Path) -> Path:
    if (folder / CONFIG).exists():
        return folder
    # Made aside and moved at once: of two processes that start together one is first for both.
    new = Path(tempfile.mkdtemp(dir=folder.parent))
    user, password = f"user-{user_number()}", secrets.token_urlsafe(24)
    auth = {"usrpwd": {"user": user, "password": password}}
    _write(new / CONFIG, json.dumps({"transport": {"auth": auth}}))
    _write(new / USERS, f"{user}:{password}\n")
    try:
        new.rename(folder)
    except OSError:
        shutil.rmtree(new)
    return folder


def _write(path: Path, text: str) -> None:
    # Closed to others before the password is in it.
    path.touch(mode=0o600)
    path.write_text(text)
