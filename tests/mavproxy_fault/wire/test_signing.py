import warnings
from typing import Any

from mavproxy_fault.fault_parts.elements import locate_element, patch_frame
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame, build_frame
from mavproxy_fault.wire.signing import Signing, derive_key, strip_signature
from tests.signed_frames import sign_frame

with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    from pymavlink.dialects.v20 import all as mavlink2

KEY = derive_key("correct horse")
LAYOUT = message_layout("HIL_GPS")


def pymavlink_link() -> Any:
    link = mavlink2.MAVLink(None, srcSystem=1, srcComponent=51)
    link.robust_parsing = True
    link.signing.secret_key = KEY
    link.signing.sign_outgoing = True
    link.signing.link_id = 3
    link.signing.timestamp = 10**12
    return link


def frame_of_pymavlink(link: Any) -> Frame:
    message = mavlink2.MAVLink_hil_gps_message(1, 3, 40000000, 5, 6, 7, 8, 9, 1, 1, 1, 1, 12)
    return Frame(bytes(message.pack(link)), LAYOUT)


def pymavlink_accepts(frame: Frame) -> bool:
    link = pymavlink_link()
    link.signing.timestamp = 10**12 - 1
    (message,) = link.parse_buffer(frame.raw)
    return bool(message.get_type() == "HIL_GPS")


def moved(frame: Frame) -> Frame:
    return patch_frame(frame, {locate_element(frame.layout, "lat"): 1})


def test_pymavlinks_signature_verifies_once() -> None:
    verifier = Signing(KEY)
    frame = frame_of_pymavlink(pymavlink_link())
    assert verifier.verify(frame)
    assert not verifier.verify(frame), "a replayed frame is refused"


def test_a_changed_payload_or_another_key_is_refused() -> None:
    frame = frame_of_pymavlink(pymavlink_link())
    assert not Signing(KEY).verify(moved(frame))
    assert not Signing(derive_key("wrong")).verify(frame)


def test_pymavlink_accepts_a_patched_frame_signed_again_and_refuses_it_otherwise() -> None:
    changed = moved(frame_of_pymavlink(pymavlink_link()))
    assert pymavlink_accepts(Signing(KEY).sign_outgoing(changed))
    assert not pymavlink_accepts(changed)


def test_a_stripped_frame_equals_the_frame_never_signed() -> None:
    plain = Frame(build_frame(LAYOUT, {"lat": 5, "fix_type": 3}, system=1, component=51), LAYOUT)
    frame = sign_frame(plain, KEY, 3, 10**12)
    assert pymavlink_accepts(frame)
    assert strip_signature(frame).raw == plain.raw
