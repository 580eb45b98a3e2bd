"""Comparison of compiled and interpreted reassembly, with lost and mixed fragments."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from mavproxy_fault.rtcm.transport import Reassembler, message_number, split_fragments, wrap_message
from mavproxy_fault.rtcm.tunnel_columns import SENDERS_MAX, Assembler, Messages

WIDTH = 128

lengths = st.sampled_from((0, 1, 2, 40, 121, 122, 247, 248, 260, 375, 502))
bodies = st.builds(lambda n, fill: bytes([fill]) * n, lengths, st.integers(0, 255))


@st.composite
def payloads(draw) -> list[tuple[int, bytes]]:
    """Generate sender and payload of TUNNEL frames: shuffled and lost fragments, garbage."""
    found: list[tuple[int, bytes]] = []
    for sequence, body in enumerate(draw(st.lists(bodies, max_size=14))):
        sender = draw(st.integers(0, 2))
        parts = [(sender, part) for part in split_fragments(wrap_message(body), sequence % 7)]
        found += parts[1:] if draw(st.integers(0, 9)) == 0 else parts
    found += [(0, garbage) for garbage in draw(st.lists(st.binary(max_size=WIDTH), max_size=3))]
    return draw(st.permutations(found)) if draw(st.booleans()) else found


def added(assembler: Assembler, rows: list[tuple[int, bytes]]) -> list[tuple[int, bytes]]:
    """Return the messages that payloads complete, with the completing row."""
    table = np.zeros((len(rows), WIDTH), np.uint8)
    for i, (_, payload) in enumerate(rows):
        table[i, : len(payload)] = np.frombuffer(payload, np.uint8)
    sender = np.array([sender for sender, _ in rows], np.int64)
    messages = assembler.add(sender, table, np.array([len(p) for _, p in rows], np.int64))
    found = listed(messages)
    assert messages.number.tolist() == [message_number(message) for message in found]
    return list(zip(messages.row.tolist(), found, strict=True))


def listed(messages: Messages) -> list[bytes]:
    return [messages.bytes(i) for i in range(len(messages.ends))]


@given(payloads(), st.data())
def test_any_payloads_give_the_same_messages_as_the_reassembler(rows, data):
    boxes = {sender: Reassembler() for sender, _ in rows}
    wanted = [(i, m) for i, (sender, p) in enumerate(rows) for m in boxes[sender].add(p)]
    assembler, found, begin = Assembler(), [], 0
    for end in (*sorted(data.draw(st.sets(st.integers(0, len(rows)), max_size=5))), len(rows)):
        found += [(begin + row, message) for row, message in added(assembler, rows[begin:end])]
        begin = end
    assert found == wanted


def test_a_length_beyond_the_payload_is_ignored():
    payload = np.zeros((1, WIDTH), np.uint8)
    found = Assembler().add(np.zeros(1, np.int64), payload, np.array([WIDTH + 1]))
    assert listed(found) == []


def test_more_senders_than_slots_lose_nothing_unless_they_mix():
    assembler, message = Assembler(), wrap_message(bytes(200))
    rows = [(n, part) for n in range(3 * SENDERS_MAX) for part in split_fragments(message, 1)]
    assert [found for _, found in added(assembler, rows)] == [message] * (3 * SENDERS_MAX)
