"""Measures the rate of a stream and detects bursts.

Samples and seconds are counted with two memories: the rate of the last seconds is compared with
that of the last minute, and with the usual deviation between the two.
"""

from dataclasses import dataclass

from analysis.detection.detector_registry import USUAL_US

# memories; the short one has at least so many samples
LONG_S, SHORT_S, SHORT_SAMPLES = 60.0, 2.0, 20.0
KNOWN_MEMORIES = 4.0  # short memories until a rate is known: 2 % of the beginning are left
# least missing share, and in usual deviations; the 182 logs of docs/watches.md are below
LEAST_MISSING, DEVIATION_FACTOR = 0.3, 4.0
SINKING_SHARE = LEAST_MISSING / 2.0  # largest missing share of a regular stream
CONFIRM_S = 1.0  # of a sparse stream, until it is reported
BURST = 5  # least size; the 182 logs of docs/watches.md have none


@dataclass(slots=True)
class StreamRate:
    """Samples and seconds of the long and the short memory; the usual deviation of their rates."""

    samples: float = 0.0
    seconds: float = 0.0
    short_samples: float = 0.0
    short_seconds: float = 0.0
    deviation: float = 0.0
    sparse_s: float = 0.0  # for how long it has been sparse
    burst: int = 0  # samples of the newest one

    def is_known(self, interval_s: float) -> bool:
        """Whether the stream has been received long enough to know its rate."""
        return self.seconds >= KNOWN_MEMORIES * max(SHORT_S, SHORT_SAMPLES * interval_s)

    def missing_share(self, interval_s: float) -> float:
        """The share of recent samples that are missing; 0 while the rate is unknown."""
        usually = self.samples * self.short_seconds
        if usually <= 0.0 or not self.is_known(interval_s):
            return 0.0
        return 1.0 - self.short_samples * self.seconds / usually

    def count_sample(self, gap_s: float, interval_s: float) -> float:
        """Count a sample `gap_s` after the last; the missing share if the stream is sparse."""
        decay = max(0.0, 1.0 - gap_s / max(SHORT_S, SHORT_SAMPLES * interval_s))
        self.short_samples = decay * self.short_samples + 1.0
        self.short_seconds = decay * self.short_seconds + gap_s
        share = self.missing_share(interval_s)
        if share <= max(LEAST_MISSING, DEVIATION_FACTOR * self.deviation):
            decay = max(0.0, 1.0 - gap_s / LONG_S)
            self.samples = decay * self.samples + 1.0
            self.seconds = decay * self.seconds + gap_s
            self.deviation = decay * self.deviation + (1.0 - decay) * abs(share)
            self.sparse_s = 0.0
            return 0.0
        self.sparse_s += gap_s
        if self.sparse_s > USUAL_US * 1e-6:
            self.samples, self.seconds = self.short_samples, self.short_seconds
        return share if self.sparse_s > CONFIRM_S else 0.0

    def burst_size(self, time_stands: bool, known: bool) -> int:
        """The number of samples that came at once if that is a burst, else 0; a sample comes at
        once with the one before if no stream's time advanced in between."""
        self.burst = self.burst + 1 if time_stands else 1
        return self.burst if known and self.burst >= BURST else 0
