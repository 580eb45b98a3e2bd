"""GTSAM's graduated non-convexity on a window: for comparison with the detector's decisions.

`GncLMOptimizer` solves the whole window again and again while it tightens a truncated least-squares
loss, so it takes tens of milliseconds where an update takes one; it is asked once per span of the
window.
"""

import gtsam

from analysis.fusion.window import FactorWindow

INLIER_WEIGHT = 0.5  # weights end near 0 or 1


def find_outliers(window: FactorWindow, sources: frozenset[str]) -> list[tuple[str, int]]:
    """Source and epoch of what does not fit the rest of the window, among some sources.

    Raises
    ------
    RuntimeError
        By GTSAM, when the system cannot be solved.
    """
    names = {
        slot: name
        for name in window.committed()
        if name[0] in sources
        for slot in window.slots(*name)
    }
    factors = window.smoother.getFactors()
    graph, slots = gtsam.NonlinearFactorGraph(), []
    for slot in range(factors.size()):
        if factors.exists(slot):
            graph.add(factors.at(slot))
            slots.append(slot)
    params = gtsam.GncLMParams()
    params.setAllowNonNoiseModelFactors(True)
    params.setLossType(gtsam.GncLossType.TLS)
    # Everything but the sources in question is taken as sound.
    params.setKnownInliers([i for i, slot in enumerate(slots) if slot not in names])
    optimizer = gtsam.GncLMOptimizer(graph, window.smoother.calculateEstimate(), params)
    optimizer.optimize()
    weights = optimizer.getWeights()
    return [names[slot] for i, slot in enumerate(slots) if weights[i] < INLIER_WEIGHT]
