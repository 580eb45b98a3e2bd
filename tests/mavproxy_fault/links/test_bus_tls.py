"""The bus over TLS with certificates of clients, and access control by their names."""

import json
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.links.bus import open_bus

ANY_PORT = "tls/localhost:0"
Signed = Callable[..., dict[str, str]]


@pytest.fixture
def signed(tmp_path: Path) -> Signed:
    """Makes a key and a certificate, signed by an authority that is made when first named."""
    if shutil.which("openssl") is None:
        pytest.skip("openssl is not installed")

    def openssl(*words: str) -> None:
        subprocess.run(["openssl", *words], check=True, capture_output=True, cwd=tmp_path)

    def make(name: str, authority: str = "lab") -> dict[str, str]:
        key = ("-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes", "-keyout")
        if not (tmp_path / f"{authority}.pem").exists():
            openssl("req", "-x509", *key, f"{authority}.key", "-out", f"{authority}.pem",
                    "-subj", f"/CN={authority}", "-days", "2")  # fmt: skip
        openssl("req", *key, f"{name}.key", "-out", f"{name}.csr", "-subj", f"/CN={name}")
        (tmp_path / "names").write_text(f"subjectAltName=DNS:localhost,DNS:{name}")
        openssl("x509", "-req", "-in", f"{name}.csr", "-CA", f"{authority}.pem", "-CAkey",
                f"{authority}.key", "-CAcreateserial", "-out", f"{name}.pem", "-days", "2",
                "-extfile", "names")  # fmt: skip
        return {part: str(tmp_path / f"{name}.{part}") for part in ("key", "pem")}

    return make


def router_config(folder: Path, own: dict[str, str], access: dict[str, Any] | None = None) -> str:
    tls = {"listen_private_key": own["key"], "listen_certificate": own["pem"],
           "root_ca_certificate": str(folder / "lab.pem"), "enable_mtls": True}  # fmt: skip
    return written(folder / "router.json5", tls, access)


def client_config(folder: Path, own: dict[str, str] | None) -> str:
    tls: dict[str, Any] = {"root_ca_certificate": str(folder / "lab.pem")}
    if own is not None:
        tls |= {"connect_private_key": own["key"], "connect_certificate": own["pem"],
                "enable_mtls": True}  # fmt: skip
    return written(folder / "client.json5", tls)


def written(path: Path, tls: dict[str, Any], access: dict[str, Any] | None = None) -> str:
    config: dict[str, Any] = {"transport": {"link": {"tls": tls}}}
    if access is not None:
        config["access_control"] = access
    path.write_text(json.dumps(config))
    return str(path)


def test_a_certificate_of_the_lab_is_accepted_and_any_other_or_none_is_refused(
    tmp_path: Path, signed: Signed
) -> None:
    router = router_config(tmp_path, signed("router"))
    friend, stranger = signed("friend"), signed("stranger", "elsewhere")
    with open_bus(ANY_PORT, run="test", router=True, config_file=router) as hub:
        hub.serve_queries("@ctl/x", lambda key, payload: "in")
        with open_bus(hub.url, run="test", config_file=client_config(tmp_path, friend)) as client:
            assert client.query("@ctl/x") == [b'"in"']
        for own in (stranger, None):
            with pytest.raises(ConfigError, match=r"tls/localhost:\d+"):
                open_bus(hub.url, run="test", config_file=client_config(tmp_path, own))


def test_access_control_lets_one_certificate_control_and_another_only_listen(
    tmp_path: Path, signed: Signed
) -> None:
    access = {
        "enabled": True,
        "default_permission": "allow",
        "rules": [{"id": "control", "permission": "deny", "flows": ["ingress"],
                   "messages": ["query"], "key_exprs": ["mavfault/v1/*/@ctl/**"]}],
        "subjects": [{"id": "watchers", "cert_common_names": ["watcher"]}],
        "policies": [{"rules": ["control"], "subjects": ["watchers"]}],
    }  # fmt: skip
    router = router_config(tmp_path, signed("router"), access)
    pilot, watcher = signed("pilot"), signed("watcher")
    with open_bus(ANY_PORT, run="test", router=True, config_file=router) as hub:
        hub.serve_queries("@ctl/x", lambda key, payload: "in")
        hub.serve_queries("state", lambda key, payload: "seen")
        with open_bus(hub.url, run="test", config_file=client_config(tmp_path, pilot)) as client:
            assert client.query("@ctl/x") == [b'"in"']
        with open_bus(hub.url, run="test", config_file=client_config(tmp_path, watcher)) as client:
            assert client.query("state") == [b'"seen"']
            with pytest.raises(ConfigError):
                client.query("@ctl/x", timeout_s=1.0)
