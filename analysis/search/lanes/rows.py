"""Where each quantity of a trajectory lies in the kernels' buffer: row * LANES + lane.

One flat float64 buffer at constant offsets lets LLVM prove that loops over lanes can be vectorised.
Units are SI, axes as in `simvehicle.vehicles.rigidbody_kernel`.
"""

LANES = 32

STATE = 0  # 13: position, velocity, quaternion, rates
CONTROL = 13  # 4: elevator, aileron, rudder, throttle
MISSION = 17  # 5: 1 or 0 (open loop), roll, its period, pitch, airspeed (see `steer_lanes`)
WIND = 22  # 3: NED, with gusts
FORCE = 25  # 3: specific force

# what the sensors say; faults act on these
MEASURED = 28
GYRO = MEASURED  # 3
ACCEL = MEASURED + 3  # 3
FIELD = MEASURED + 6  # 3, gauss
VELOCITY = MEASURED + 9  # 3, GPS, NED
DIFF_PRESSURE = MEASURED + 12  # Pa
CHANNELS = 13

BEFORE = 41  # 6: gyro and accelerometer of the sample before
NOISE = 47  # 6: standard Gaussian numbers

# the sensors' parameters
GYRO_SIGMA = 53
ACCEL_SIGMA = 54
FIELD_SIGMA = 55
VELOCITY_SIGMA = 56
PRESSURE_SIGMA = 57
GYRO_BIAS = 58  # 3
ACCEL_BIAS = 61  # 3

ESTIMATE = 64  # 9: roll, pitch, yaw, velocity, position (Heun); others write the first three
QUATERNION = 73  # 4: the estimated attitude

# scores
SQUARES = 77  # 4: sums of squared errors of roll, pitch, yaw and of the angle
LARGEST = 81  # 4: their greatest magnitudes
COUNT = 85  # samples scored
ALIVE = 86  # 1 while within the envelope
BROKEN_LIMIT = 87  # the envelope's limit that was broken first (see `LIMITS`), 0 for none

FAULTS = 88  # SLOTS slots of FAULT_ROWS
CHANNEL = 0  # offset from MEASURED; -1: none
START = 1  # s
END = 2  # s
OFFSET = 3  # added
RATE = 4  # added per second since the start
FACTOR = 5  # times the healthy value
HOLD = 6  # 1: the first value within the fault stays
FROZEN = 7  # that value, NaN before
SPREAD = 8  # sigma of noise that is added
FAULT_ROWS = 9
SLOTS = 4

NOW = FAULTS + SLOTS * FAULT_ROWS  # 13: the state when the sensors sampled
OPEN_LOOP = NOW + 13  # 4: the controls that a mission's feedback adds to
GUSTS = OPEN_LOOP + 4  # 5: states of the Dryden filters
STEADY = GUSTS + 5  # 3: the wind without gusts, NED
STATE_SQUARES = STEADY + 3  # 12: sums of squared errors of position, velocity, angles, rates
ROWS = STATE_SQUARES + 12
LIMITS = ("", "pitch", "alpha", "beta", "airspeed", "rate", "load", "ground")
