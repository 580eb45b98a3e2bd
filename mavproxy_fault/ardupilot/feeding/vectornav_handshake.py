"""How a VN-200 answers the commands that configure it, before it streams; no I/O.

Commands are ASCII lines `$...*XX` with an exclusive-or of what is between. Each is answered by
itself, which is how the sensor confirms a register; a question for the model by the model's name.
"""

from functools import reduce
from operator import xor

MODEL = b"VN-200"  # one receiver
READ_MODEL = b"VNRRG,01"
PAUSE, RESUME = b"VNASY,0", b"VNASY,1"
MOST_PENDING = 256  # bytes of a line that never ends


class Handshake:
    """The sensor's side of one serial connection; `streaming` tells whether outputs are wanted."""

    def __init__(self) -> None:
        self.streaming = False
        self._pending = b""

    def received(self, data: bytes) -> bytes:
        """The answers to the lines that these bytes complete."""
        *lines, rest = (self._pending + data).split(b"\n")
        self._pending = rest[-MOST_PENDING:]
        return b"".join(self._answer(line.rstrip(b"\r")) for line in lines)

    def _answer(self, line: bytes) -> bytes:
        _, start, sentence = line.rpartition(b"$")
        body, star, given = sentence.partition(b"*")
        if not start or not star or given.upper() != b"%02X" % checksum(body):
            return b""  # ArduPilot repeats what was not answered
        if body in (PAUSE, RESUME):
            self.streaming = body == RESUME
        answer = READ_MODEL + b"," + MODEL if body == READ_MODEL else body
        return sentence_of(answer)


def sentence_of(body: bytes) -> bytes:
    """A whole line."""
    return b"$%s*%02X\r\n" % (body, checksum(body))


def checksum(body: bytes) -> int:
    """Exclusive-or of all bytes."""
    return reduce(xor, body, 0)
