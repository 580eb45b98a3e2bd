"""An epoch against the prediction: what a change of satellites leaves behind."""

from analysis.detection import Detector
from analysis.detection.filter.information import normal_equations
from analysis.detection.filter.propagation import predict
from analysis.detection.isolation.epoch_memory import FrozenOffsets, frozen_offsets_m
from analysis.detection.isolation.epoch_statistics import parity_test
from analysis.detection.stages.assess import MOVED_PROBABILITY, assess
from analysis.detection.statistics.chi_square import chi_square_threshold
from analysis.samples.sample import Epoch


def test_frozen_offsets_move_a_snapshot_no_further_than_lasting_errors_do(flight):
    detector = Detector()
    at = [i for i, sample in enumerate(flight) if isinstance(sample, Epoch)][60]
    state = detector.new_state()
    for sample in flight[: at + 1]:
        _, state = detector.step(sample, state)
    record, config = state.core.history[-1], detector.config
    known = record.core.memory
    names = known.ramps.names
    # Each of the first six was 20 m too long once, and another satellite is used than then.
    frozen = FrozenOffsets(record.core.motion.t_us, dict.fromkeys(names[:6], 20.0))
    others = known.ramps._replace(names=(*names[:-1], "G99"))
    core = record.core._replace(memory=known._replace(frozen=frozen, ramps=others))
    prediction = predict(core.motion, record.run, record.t_us, config)
    found = assess(record.observation, prediction, core, config)
    used, offsets_m = (
        found.innovations,
        frozen_offsets_m(found.memory.frozen, found.satellites, record.t_us, config),
    )
    normal = normal_equations(used.geometry, used.variance, offsets_m, used.variance)
    limit = chi_square_threshold(len(normal.b), MOVED_PROBABILITY)
    moved = normal.total - parity_test(normal)[0]
    assert 0.5 * limit < moved < 1.01 * limit
    assert 0.0 < max(offsets_m) < 10.0
