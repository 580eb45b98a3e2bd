"""Sensor fusion behind the detector's exclusions: a fixed-lag smoother on a factor graph (GTSAM).

`smoother` is the entry point; `fusion_config` and `factors.factor_weights` import without GTSAM.
See docs/fusion.md.
"""
