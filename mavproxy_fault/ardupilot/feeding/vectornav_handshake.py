"""Replies of a VN-200 to the commands that configure it before it streams; no I/O.

Commands are ASCII lines `$...*XX`, where XX is the XOR of the bytes between. The sensor confirms a
command by echoing it, and a request for the model with the model's name.
"""

from functools import reduce
from operator import xor

from mavproxy_fault.ardupilot.feeding.vectornav import BinaryOutput
from mavproxy_fault.documents.errors import ConfigError

MODEL = b"VN-200"  # model with a single receiver
MODEL_REGISTER = 1
OUTPUT_REGISTERS = (75, 76, 77)  # registers: port, divisor, groups, field words (hexadecimal)
MAX_PENDING = 256  # bytes kept of an endless line


class Handshake:
    """The sensor's side of one serial connection."""

    def __init__(self) -> None:
        self._outputs: dict[int, BinaryOutput] = {}
        self._paused = False
        self._pending = b""

    @property
    def outputs(self) -> tuple[BinaryOutput, ...]:
        """Active outputs; none before the configuration or while paused."""
        return () if self._paused else tuple(self._outputs.values())

    def received(self, data: bytes) -> bytes:
        """Return the replies to the lines that these bytes complete.

        Raises
        ------
        ConfigError
            If an unsupported output is requested.
        """
        *lines, rest = (self._pending + data).split(b"\n")
        self._pending = rest[-MAX_PENDING:]
        return b"".join(self._answer(line.rstrip(b"\r")) for line in lines)

    def _answer(self, line: bytes) -> bytes:
        _, start, sentence = line.rpartition(b"$")
        body, star, given = sentence.partition(b"*")
        if not start or not star or given.upper() != b"%02X" % xor_checksum(body):
            return b""  # ArduPilot repeats unanswered commands
        try:
            return format_sentence(self._execute(body))
        except ConfigError:
            raise
        except ValueError:
            return b""  # an invalid number

    def _execute(self, body: bytes) -> bytes:
        """Execute a command and return its reply."""
        match body.split(b","):
            # ArduPilot 4.5 omits the leading zero.
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
    """Format a complete line with its checksum."""
    return b"$%s*%02X\r\n" % (body, xor_checksum(body))


def xor_checksum(body: bytes) -> int:
    """Compute the XOR of all bytes."""
    return reduce(xor, body, 0)
