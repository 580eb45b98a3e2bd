"""Fusion of what the detector finds healthy: a fixed-lag smoother on a factor graph (GTSAM).

`fusion_config` and `factors.factor_weights` need no GTSAM; `smoother`, the rest's entrance,
does. See docs/fusion.md.
"""
