"""What an estimator of another package imports; `mavproxy-fault new estimator NAME` writes one."""

from analysis.estimators import AttitudeEstimate, Estimator, Prior, estimator_names, make_estimator
from analysis.samples.sample import (
    AirspeedSample,
    BaroSample,
    GpsFix,
    ImuSample,
    MagSample,
    RangeSample,
    Sample,
    VisionSample,
)
from mavproxy_fault.numerics.rotations.one_rotation import rotate_quaternion
from mavproxy_fault.numerics.rotations.rotation import (
    euler_from_quat,
    matrix_from_quat,
    quat_from_euler,
    quat_from_matrix,
)

__all__ = [
    "AirspeedSample", "AttitudeEstimate", "BaroSample", "Estimator", "GpsFix", "ImuSample",
    "MagSample", "Prior", "RangeSample", "Sample", "VisionSample", "estimator_names",
    "euler_from_quat", "make_estimator", "matrix_from_quat", "quat_from_euler", "quat_from_matrix",
    "rotate_quaternion",
]  # fmt: skip
