"""Credentials of the bus: by default only programs of the user who opened it may join.

A loopback port is open to every user of the machine, and any client of the bus can stop a vehicle's
traffic. So the router requires a name and a password from a file that only its user can read. Any
Zenoh program of that user can join with this file as its configuration.
"""

import json
import secrets
import shutil
import tempfile
from pathlib import Path

from mavproxy_fault.documents.atomic_file import write_private
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.numerics.code_cache import is_usable, user_folders, user_number

CONFIG, USERS = "config.json5", "users.txt"


def credentials_folder() -> Path:
    """Return the folder with the bus configuration and user list, created at first use.

    Raises
    ------
    ConfigError
        If there is no writable folder for them.
    """
    for place in user_folders("XDG_STATE_HOME", ".local/state"):
        if is_usable(place):
            return _create_credentials(place / "zenoh")
    raise ConfigError(
        "--zenoh: no folder for the bus's password; set XDG_STATE_HOME to a writable one, or give"
        " --zenoh-config FILE or --zenoh off"
    )


def _create_credentials(folder: Path) -> Path:
    if (folder / CONFIG).exists():
        return folder
    # Created aside and renamed atomically: of two concurrent processes both use the first one's.
    new = Path(tempfile.mkdtemp(dir=folder.parent))
    user, password = f"user-{user_number()}", secrets.token_urlsafe(24)
    auth = {"usrpwd": {"user": user, "password": password}}
    write_private(new / CONFIG, json.dumps({"transport": {"auth": auth}}).encode())
    write_private(new / USERS, f"{user}:{password}\n".encode())
    try:
        new.rename(folder)
    except OSError:
        shutil.rmtree(new)
    return folder
