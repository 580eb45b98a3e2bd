"""Where each quantity of a trajectory lies in the kernels' buffer: row * LANES + lane.

One flat float64 buffer at constant offsets lets LLVM prove that loops over lanes can be vectorised.
Units are SI, axes as in `simvehicle.vehicles.rigidbody_kernel`.
"""

LANES = 32

STATE = 0  # 13: position, velocity, quaternion, rates
CONTROL = 13  # 4: elevator, aileron, rudder, throttle; or a quadrotor's motors
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
ABS_PRESSURE = MEASURED + 13  # Pa
PLACE = MEASURED + 14  # 3, GPS, NED from the start's ground
CHANNELS = 17

BEFORE = MEASURED + CHANNELS  # 6: gyro and accelerometer of the sample before
NOISE = BEFORE + 6  # 6: standard Gaussian numbers

# the sensors' parameters
GYRO_SIGMA = NOISE + 6
ACCEL_SIGMA = GYRO_SIGMA + 1
FIELD_SIGMA = GYRO_SIGMA + 2
VELOCITY_SIGMA = GYRO_SIGMA + 3
PRESSURE_SIGMA = GYRO_SIGMA + 4
STATIC_SIGMA = GYRO_SIGMA + 5
STATIC_BIAS = GYRO_SIGMA + 6
STATIC_DRIFT = GYRO_SIGMA + 7  # Pa/K from the standard temperature of the sea's level
PLACE_KICK = GYRO_SIGMA + 8  # 3: of the GPS position's Gauss-Markov error, by sample
GYRO_BIAS = GYRO_SIGMA + 11  # 3
ACCEL_BIAS = GYRO_BIAS + 3  # 3

START_DOWN = ACCEL_BIAS + 3  # where the flight began
PLACE_ERROR = START_DOWN + 1  # 3: the GPS position's error now
ESTIMATE = PLACE_ERROR + 3  # 9: roll, pitch, yaw, velocity, position (Heun); others write three
QUATERNION = ESTIMATE + 9  # 4: the estimated attitude

# scores
SQUARES = QUATERNION + 4  # 4: sums of squared errors of roll, pitch, yaw and of the angle
LARGEST = SQUARES + 4  # 4: their greatest magnitudes
COUNT = LARGEST + 4  # samples scored
ALIVE = COUNT + 1  # 1 while within the envelope
BROKEN_LIMIT = ALIVE + 1  # the limit that was broken first (see `LIMITS`), 0 for none

FAULTS = BROKEN_LIMIT + 1  # SLOTS slots of FAULT_ROWS
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
INVERTED_SQUARES = STATE_SQUARES + 12  # 5: height, airspeed, position; samples of each kind
MOTOR = INVERTED_SQUARES + 5  # 4: speeds of a quadrotor's motors, rad/s
ROWS = MOTOR + 4
LIMITS = ("", "pitch", "alpha", "beta", "airspeed", "rate", "load", "ground")
