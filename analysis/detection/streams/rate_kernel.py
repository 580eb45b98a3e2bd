"""Measures the rate of a stream and detects bursts, compiled.

Samples and seconds are counted with two memories: the rate of the last seconds is compared with
that of the last minute, and with the usual deviation between the two.
"""

from analysis.samples.sample import Vector
from mavproxy_fault.numerics.compile import inlined

# Of a stream: samples and seconds of the long memory and of the short one; the usual deviation of
# their rates; how long it has been sparse; samples of the newest burst, and of the usual one
(
    SAMPLES,
    SECONDS,
    SHORT_TERM_SAMPLES,
    SHORT_TERM_SECONDS,
    DEVIATION,
    SPARSE_S,
    BURST_COUNT,
    USUAL_BURST,
) = range(8)
COLUMNS = 8
# memories; the short one has at least so many samples
LONG_S, SHORT_S, SHORT_SAMPLES = 60.0, 2.0, 20.0
KNOWN_MEMORIES = 4.0  # short memories until a rate is known, chosen
# least missing share, and in usual deviations; the 182 logs of docs/watches.md are below
LEAST_MISSING, DEVIATION_FACTOR = 0.3, 4.0
SINKING_SHARE = 0.15  # largest missing share of a regular stream, chosen: half of LEAST_MISSING
# of a sparse stream: until it is reported, and until the rate is the usual one
CONFIRM_S, USUAL_S = 1.0, 20.0
# least size of a burst, and in usual bursts; chosen on the 182 logs of docs/watches.md
BURST, BURST_FACTOR = 5.0, 2.0


@inlined
def is_rate_known(rates: Vector, s: int, interval_s: float) -> bool:
    """Whether the stream has been received long enough to know its rate."""
    known: bool = rates[s, SECONDS] >= KNOWN_MEMORIES * max(SHORT_S, SHORT_SAMPLES * interval_s)
    return known


@inlined
def missing_share(rates: Vector, s: int, interval_s: float) -> float:
    """The share of recent samples that are missing; 0 while the rate is unknown."""
    usually = rates[s, SAMPLES] * rates[s, SHORT_TERM_SECONDS]
    if usually <= 0.0 or not is_rate_known(rates, s, interval_s):
        return 0.0
    share: float = 1.0 - rates[s, SHORT_TERM_SAMPLES] * rates[s, SECONDS] / usually
    return share


@inlined
def count_sample(rates: Vector, s: int, gap_s: float, interval_s: float) -> float:
    """Count a sample `gap_s` after the last, in place; the missing share if sparse, else 0."""
    short_s = max(SHORT_S, SHORT_SAMPLES * interval_s)
    decay = max(0.0, 1.0 - gap_s / short_s)
    rates[s, SHORT_TERM_SAMPLES] = decay * rates[s, SHORT_TERM_SAMPLES] + 1.0
    rates[s, SHORT_TERM_SECONDS] = decay * rates[s, SHORT_TERM_SECONDS] + gap_s
    share = missing_share(rates, s, interval_s)
    if share <= max(LEAST_MISSING, DEVIATION_FACTOR * rates[s, DEVIATION]):
        decay = max(0.0, 1.0 - gap_s / LONG_S)
        rates[s, SAMPLES] = decay * rates[s, SAMPLES] + 1.0
        rates[s, SECONDS] = decay * rates[s, SECONDS] + gap_s
        rates[s, DEVIATION] = decay * rates[s, DEVIATION] + (1.0 - decay) * abs(share)
        rates[s, SPARSE_S] = 0.0
        return 0.0
    rates[s, SPARSE_S] += gap_s
    if rates[s, SPARSE_S] > USUAL_S:
        rates[s, SAMPLES], rates[s, SECONDS] = (
            rates[s, SHORT_TERM_SAMPLES],
            rates[s, SHORT_TERM_SECONDS],
        )
    return share if rates[s, SPARSE_S] > CONFIRM_S else 0.0


@inlined
def burst_size(rates: Vector, s: int, time_stands: bool, known: bool) -> float:
    """The number of samples that came at once if that is a burst, else 0; a sample comes at once
    with the one before if no stream's time advanced in between."""
    limit = max(BURST, BURST_FACTOR * rates[s, USUAL_BURST])
    if not time_stands:
        if not known or rates[s, BURST_COUNT] < limit:
            rates[s, USUAL_BURST] = max(rates[s, USUAL_BURST], rates[s, BURST_COUNT])
        rates[s, BURST_COUNT] = 1.0
        return 0.0
    rates[s, BURST_COUNT] += 1.0
    return rates[s, BURST_COUNT] if known and rates[s, BURST_COUNT] >= limit else 0.0
