"""GTSAM's graduated non-convexity on a window, for comparison with the detector's exclusions.

`GncLMOptimizer` solves the entire window repeatedly while it tightens a truncated least-squares
loss, tens of milliseconds against one for an update, so it runs once per span of the window.
"""

import gtsam

from analysis.fusion.window import FactorWindow

INLIER_WEIGHT = 0.5  # GNC weights converge to 0 or 1; 0.5 separates them


def find_outliers(window: FactorWindow, sources: frozenset[str]) -> list[tuple[str, int]]:
    """Source and epoch of the measurements of some sources that do not fit the rest of the window.

    Raises
    ------
    RuntimeError
        From GTSAM, if the system cannot be solved.
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
    # All other sources are known inliers.
    params.setKnownInliers([i for i, slot in enumerate(slots) if slot not in names])
    optimizer = gtsam.GncLMOptimizer(graph, window.smoother.calculateEstimate(), params)
    optimizer.optimize()
    weights = optimizer.getWeights()
    return [names[slot] for i, slot in enumerate(slots) if weights[i] < INLIER_WEIGHT]
