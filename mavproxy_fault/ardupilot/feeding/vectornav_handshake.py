"""How a VN-200 answers the commands that configure it, before it streams; no I/O.

Commands are ASCII lines `$...*XX` with an exclusive-or of what is between. Each is answered by
itself, which is how the sensor confirms a register; a question for the model by the model's name.
"""

from functools import reduce
from operator import xor

from mavproxy_fault.ardupilot.feeding.vectornav import BinaryOutput
from mavproxy_fault.documents.errors import ConfigError

MODEL = b"VN-200"  # one receiver
MODEL_REGISTER = 1
OUTPUT_REGISTERS = (75, 76, 77)  # registers: port, divisor, groups, their fields (hexadecimal)
MAX_PENDING = 256  # bytes of a line that never ends


class Handshake:
    """The sensor's side of one serial connection."""

    def __init__(self) -> None:
        self._outputs: dict[int, BinaryOutput] = {}
        self._paused = False
        self._pending = b""

    @property
    def outputs(self) -> tuple[BinaryOutput, ...]:
        """What is wanted now; nothing before it is configured, or while it is paused."""
        return () if self._paused else tuple(self._outputs.values())

    def received(self, data: bytes) -> bytes:
        """The answers to the lines that these bytes complete.

        Raises
        ------
        ConfigError
            If an output is asked for that is not served.
        """
        *lines, rest = (self._pending + data).split(b"\n")
        self._pending = rest[-MAX_PENDING:]
        return b"".join(self._answer(line.rstrip(b"\r")) for line in lines)

    def _answer(self, line: bytes) -> bytes:
        _, start, sentence = line.rpartition(b"$")
        body, star, given = sentence.partition(b"*")
        if not start or not star or given.upper() != b"%02X" % xor_checksum(body):
            return b""  # ArduPilot repeats what was not answered
        try:
            return format_sentence(self._execute(body))
        except ConfigError:
            raise
        except ValueError:
            return b""  # a number that is none

    def _execute(self, body: bytes) -> bytes:
        """Carry a command out; its answer."""
        match body.split(b","):
            # ArduPilot 4.5 leaves out the zero.
            case [b"VNRRG", register] if int(register) == MODEL_REGISTER:
                return b"VNRRG,%02d,%s" % (MODEL_REGISTER, MODEL)
            case [b"VNASY", on]:
                self._paused = on == b"0"
            case [b"VNWRG", register, _, _, *choice] if (
                choice and int(register) in OUTPUT_REGISTERS
            ):
                groups, *words = (int(text, 16) for text in choice)
                self._outputs[int(register)] = BinaryOutput(groups, words)
        return body


def format_sentence(body: bytes) -> bytes:
    """A whole line."""
    return b"$%s*%02X\r\n" % (body, xor_checksum(body))


def xor_checksum(body: bytes) -> int:
    """Exclusive-or of all bytes."""
    return reduce(xor, body, 0)
