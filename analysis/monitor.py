"""The monitor: MAVLink bytes to results and their summary, whatever they came from."""

from collections.abc import Iterable, Sequence
from typing import Any

from analysis.criteria import Criteria
from analysis.epochs import Decoder
from analysis.pipeline import MonitorConfig, Pipeline
from analysis.results import Result
from analysis.samples import Sample, TruthSample
from analysis.tally import Tally
from mavproxy_fault.wire.frame import Frame
from mavproxy_fault.wire.label import Label
from mavproxy_fault.wire.parser import Parser


class Monitor:
    """Parser, decoder, pipeline and tally in a row."""

    def __init__(self, config: MonitorConfig) -> None:
        self._parser = Parser()
        self._decoder = Decoder()
        self._pipeline = Pipeline(config)
        self._tally = Tally()

    @property
    def t_s(self) -> float:
        """Seconds from the first sample to the newest, on the vehicle's clock."""
        return self._tally.span_s

    def bytes(self, data: bytes, *, datagram: bool = True) -> list[Result]:
        """Results of the frames in some bytes; a stream's may be cut anywhere."""
        items = self._parser.push(data, datagram=datagram)
        return [r for item in items if isinstance(item, Frame) for r in self.frame(item)]

    def frame(self, frame: Frame) -> list[Result]:
        """Results of one frame."""
        return self.samples(self._decoder.decode(frame))

    def samples(self, samples: Iterable[Sample]) -> list[Result]:
        """Results of samples in order."""
        results: list[Result] = []
        for sample in samples:
            if isinstance(sample, TruthSample):
                self._tally.truth(sample)
            else:
                self._tally.clock(sample.t_us)
            results += self._pipeline.push(sample)
        for result in results:
            self._tally.add(result)
        return results

    def summary(
        self, labels: Sequence[Label] | None, criteria: Criteria, wall_s: float
    ) -> dict[str, Any]:
        """The content of `summary.json`; without labels no alarm can be called false."""
        attitude = self._pipeline.attitude(labels or ())
        return self._tally.summary(labels, attitude, criteria, wall_s)
