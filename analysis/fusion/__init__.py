"""Fusion of what the detector finds healthy: a fixed-lag smoother on a factor graph (GTSAM).

`config` and `weights` need no GTSAM; `smoother`, the rest's entrance, does. See docs/fusion.md.
"""
