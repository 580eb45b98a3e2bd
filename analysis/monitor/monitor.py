"""The monitor: MAVLink bytes to results and their summary, from a link or a log."""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from analysis.monitor.pipeline import MonitorConfig, Pipeline
from analysis.recordings.position_reference import PositionReference
from analysis.results import Result
from analysis.samples.block import Block
from analysis.samples.decoder import MESSAGES, Decoder
from analysis.scoring.criteria import Criteria
from analysis.scoring.summary_tally import Tally
from mavproxy_fault.wire.frame import Frame
from mavproxy_fault.wire.label import Label
from mavproxy_fault.wire.parser import Parser
from mavproxy_fault.wire.tlog import read_ordered


class Monitor:
    """Parser, decoder, pipeline and tally in a chain."""

    def __init__(self, config: MonitorConfig, reference: PositionReference | None = None) -> None:
        self._parser = Parser()
        self._decoder = Decoder()
        self._pipeline = Pipeline(config)
        self.alarms = self._pipeline.alarms  # so far, by the name of the detector
        self.detector = config.detector
        self._tally = Tally(reference, link=config.link)
        self.positions = self._tally.positions  # their errors so far

    @property
    def t_s(self) -> float:
        """Seconds from the first sample to the newest, on the vehicle's clock."""
        return self._tally.span_s

    def push_bytes(self, chunks: Iterable[bytes], *, datagrams: bool = True) -> list[Result]:
        """The results of some chunks of bytes; a stream's frames may be cut anywhere."""
        # Frames of a datagram are complete; a stream's may end anywhere.
        items = (item for data in chunks for item in self._parser.push(data, datagram=datagrams))
        # The parser has counted bytes that are no frame; they have no samples.
        return self.push(self._decoder.decode(i for i in items if isinstance(i, Frame)))

    def push_records(self, records: bytes) -> list[Result]:
        """The results of complete records of a log, parsed by compiled code."""
        results: list[Result] = []
        for columns, orders in read_ordered(np.frombuffer(records, np.uint8), MESSAGES):
            results += self.push(self._decoder.decode_columns(columns, orders))
        return results

    def set_log_gaps(self, lost_us: Sequence[tuple[int, int]]) -> None:
        """Ignore silences during and just after times in which a log's writer lost records."""
        self._pipeline.set_log_gaps(lost_us)

    def push(self, block: Block) -> list[Result]:
        """The results of samples in order."""
        results = self._pipeline.push_rows(block)
        self._tally.add(block, results)
        return [result for _, result in results]

    def summary(
        self, labels: Sequence[Label] | None, criteria: Criteria, wall_s: float
    ) -> dict[str, Any]:
        """The content of `summary.json`; without labels no alarm counts as false."""
        attitude = self._pipeline.attitude(labels or ())
        return self._tally.summary(labels, attitude, criteria, wall_s)
