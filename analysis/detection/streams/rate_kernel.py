"""How often the samples of a stream come, and whether several come at once, compiled.

Samples and seconds are counted with two memories: the rate of the last seconds is held against that
of the last minute, and against how far the two usually lie apart.
"""

from analysis.samples.sample import Vector
from mavproxy_fault.numerics.compile import inlined

# Of a stream: samples and seconds of the long memory and of the short one; how far their rates
# usually lie apart; for how long it has come too seldom; samples that came at once, and usually do
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
LONG_S, SHORT_S, SHORT_SAMPLES = 60.0, 2.0, 20.0  # memories; the short one holds so many samples
KNOWN_MEMORIES = 4.0  # short memories after which a rate is known
LEAST_MISSING, DEVIATION_FACTOR = 0.3, 4.0  # that is missing: alone, and in what is usually
SINKING_SHARE = 0.15  # less than that is missing where a stream comes as it should
CONFIRM_S, USUAL_S = 1.0, 20.0  # of what comes too seldom: until it is told, and until it is usual
BURST, BURST_FACTOR = 5.0, 2.0  # samples at once: alone, and in what is usually


@inlined
def is_rate_known(rates: Vector, s: int, interval_s: float) -> bool:
    """Whether a stream has come for long enough to know its rate."""
    known: bool = rates[s, SECONDS] >= KNOWN_MEMORIES * max(SHORT_S, SHORT_SAMPLES * interval_s)
    return known


@inlined
def missing_share(rates: Vector, s: int, interval_s: float) -> float:
    """The share of the samples that did not come lately; 0 while the rate is not known."""
    usually = rates[s, SAMPLES] * rates[s, SHORT_TERM_SECONDS]
    if usually <= 0.0 or not is_rate_known(rates, s, interval_s):
        return 0.0
    share: float = 1.0 - rates[s, SHORT_TERM_SAMPLES] * rates[s, SECONDS] / usually
    return share


@inlined
def count_sample(rates: Vector, s: int, gap_s: float, interval_s: float) -> float:
    """Count a sample that came `gap_s` after the one before, in place; the share that is missing
    of a stream that has come too seldom for a while, else 0."""
    short_s = max(SHORT_S, SHORT_SAMPLES * interval_s)
    kept = max(0.0, 1.0 - gap_s / short_s)
    rates[s, SHORT_TERM_SAMPLES] = kept * rates[s, SHORT_TERM_SAMPLES] + 1.0
    rates[s, SHORT_TERM_SECONDS] = kept * rates[s, SHORT_TERM_SECONDS] + gap_s
    share = missing_share(rates, s, interval_s)
    if share <= max(LEAST_MISSING, DEVIATION_FACTOR * rates[s, DEVIATION]):
        kept = max(0.0, 1.0 - gap_s / LONG_S)
        rates[s, SAMPLES] = kept * rates[s, SAMPLES] + 1.0
        rates[s, SECONDS] = kept * rates[s, SECONDS] + gap_s
        rates[s, DEVIATION] = kept * rates[s, DEVIATION] + (1.0 - kept) * abs(share)
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
    """How many samples have come at once, if that is a burst, else 0; a sample comes at once with
    the one before if nobody's time went on in between."""
    limit = max(BURST, BURST_FACTOR * rates[s, USUAL_BURST])
    if not time_stands:
        if not known or rates[s, BURST_COUNT] < limit:
            rates[s, USUAL_BURST] = max(rates[s, USUAL_BURST], rates[s, BURST_COUNT])
        rates[s, BURST_COUNT] = 1.0
        return 0.0
    rates[s, BURST_COUNT] += 1.0
    return rates[s, BURST_COUNT] if known and rates[s, BURST_COUNT] >= limit else 0.0
