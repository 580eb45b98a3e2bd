"""Field map of MAVLink messages; units and "unknown" values are those of the common set.

Bits of `fields_updated`: 0 to 5 acceleration and rates, 6 to 8 magnetic field, 9 static pressure,
10 differential pressure (HIL_SENSOR_UPDATED_FLAGS). All of a sample's bits are required: one with a
stale axis is unusable. Flags: ESTIMATOR_STATUS_FLAGS and EKF_STATUS_FLAGS.
"""

from analysis.field_maps.field_map import read_map

TLOG = read_map(
    r"""
ATTITUDE
  roll  ATTITUDE  roll * DEG
  pitch  ATTITUDE  pitch * DEG
  yaw  ATTITUDE  wrapped(yaw * DEG)
  rate-{roll,pitch,yaw}  actual  {roll,pitch,yaw}speed * DEG
  ATTITUDE  all  quat(roll, pitch, yaw), system, ATTITUDE
ATTITUDE_QUATERNION
  {roll,pitch,yaw}  ATTITUDE_QUATERNION  euler(stack(q1, q2, q3, q4))[{0,1,2}]
  ATTITUDE  all  q1, q2, q3, q4, system, ATTITUDE_QUATERNION
ATTITUDE_TARGET
  {roll,pitch,yaw}  desired  euler(q)[{0,1,2}]
  rate-{roll,pitch,yaw}  desired  body_{roll,pitch,yaw}_rate * DEG
AHRS2
  roll  AHRS2  roll * DEG
  pitch  AHRS2  pitch * DEG
  yaw  AHRS2  wrapped(yaw * DEG)
HIL_STATE_QUATERNION
  {roll,pitch,yaw}  truth  euler(attitude_quaternion)[{0,1,2}]
  altitude  truth  alt * 1e-3
  speed  truth  norm(vx, vy) * 1e-2
  climb  truth  vz * -1e-2
  track  truth  lat * 1e-7, lon * 1e-7, alt * 1e-3
  TRUTH  all  attitude_quaternion, rollspeed, pitchspeed, yawspeed, lat * 1e-7, lon * 1e-7, \
    alt * 1e-3, vx * 1e-2, vy * 1e-2, vz * 1e-2
GLOBAL_POSITION_INT
  altitude  estimate  alt * 1e-3
  height  estimate  relative_alt * 1e-3
  climb  estimate  vz * -1e-2
  track  estimate  lat * 1e-7, lon * 1e-7, alt * 1e-3
LOCAL_POSITION_NED
  velocity-{north,east,down}  estimate  v{x,y,z}
  position-{north,east,down}  estimate  {x,y,z}
POSITION_TARGET_LOCAL_NED
  velocity-{north,east,down}  desired  v{x,y,z}
  position-{north,east,down}  desired  {x,y,z}
VFR_HUD
  speed  ground  groundspeed
  speed  air  airspeed
  climb  VFR_HUD  climb
  throttle  throttle  throttle
ESTIMATOR_STATUS
  ratio  velocity  vel_ratio
  ratio  horizontal position  pos_horiz_ratio
  ratio  vertical position  pos_vert_ratio
  ratio  magnetometer  mag_ratio
  ratio  height above ground  hagl_ratio
  ratio  airspeed  tas_ratio
  accuracy  horizontal  accuracy(pos_horiz_accuracy)
  accuracy  vertical  pos_vert_accuracy
  flag  GPS glitch  bit(flags, 10)
  flag  accelerometer error  bit(flags, 11)
EKF_STATUS_REPORT
  variance  velocity  velocity_variance
  variance  horizontal position  pos_horiz_variance
  variance  vertical position  pos_vert_variance
  variance  compass  compass_variance
  variance  terrain  terrain_alt_variance
  flag  GPS glitch  bit(flags, 15)
GPS_RAW_INT
  altitude  GPS  alt * 1e-3
  speed  GPS  known(vel, 65535) * 1e-2
  gps-satellites  GPS  known(satellites_visible, 255)
  gps-dilution  {eph,epv}  where(({eph,epv} == 0) | ({eph,epv} >= 9999), nan, {eph,epv} * 1e-2)
  gps-accuracy  horizontal  accuracy(h_acc * 1e-3)
  gps-accuracy  vertical  accuracy(v_acc * 1e-3)
  gps-accuracy  speed, m/s  known(vel_acc, 0) * 1e-3
  gps-fix  GPS  fix_type
  track  GPS  lat * 1e-7, lon * 1e-7, alt * 1e-3
  FIX  all  lat * 1e-7, lon * 1e-7, alt * 1e-3, \
    course(known(vel, 65535) * 1e-2, known(cog, 65535) * 1e-2), nan, fix_type, \
    satellites_visible, known(h_acc, 0) * 1e-3, known(v_acc, 0) * 1e-3, GPS_RAW_INT
GPS2_RAW
  gps-satellites  GPS 2  known(satellites_visible, 255)
  gps-fix  GPS 2  fix_type
  FIX#1  fix_type >= 3  lat * 1e-7, lon * 1e-7, alt * 1e-3
HIL_GPS
  altitude  HIL_GPS  alt * 1e-3
  speed  HIL_GPS  known(vel, 65535) * 1e-2
  gps-satellites  HIL_GPS  known(satellites_visible, 255)
  gps-fix  HIL_GPS  fix_type
  track  HIL_GPS  lat * 1e-7, lon * 1e-7, alt * 1e-3
  FIX  all  lat * 1e-7, lon * 1e-7, alt * 1e-3, vn * 1e-2, ve * 1e-2, vd * 1e-2, fix_type, \
    satellites_visible, known(eph, 65535) * 1e-2, known(epv, 65535) * 1e-2, HIL_GPS
GPS_STATUS
  gps-cn0  strongest  rank(satellite_snr, 1)
  gps-cn0  fourth strongest  rank(satellite_snr, 4)
HIL_SENSOR
  accel  {x,y,z}  {x,y,z}acc
  gyro  {x,y,z}  {x,y,z}gyro
  mag  HIL_SENSOR  norm(xmag, ymag, zmag)
  baro  HIL_SENSOR  abs_pressure
  IMU  fields_updated & 0x3F == 0x3F  xgyro, ygyro, zgyro, xacc, yacc, zacc, id
  MAG  fields_updated & 0x1C0 == 0x1C0  xmag, ymag, zmag
  BARO  fields_updated & 0x200 == 0x200  abs_pressure * 100.0, pressure_alt
  AIRSPEED  fields_updated & 0x400 == 0x400  diff_pressure * 100.0
HIGHRES_IMU
  accel  {x,y,z} (HIGHRES)  {x,y,z}acc
  gyro  {x,y,z} (HIGHRES)  {x,y,z}gyro
  mag  HIGHRES_IMU  norm(xmag, ymag, zmag)
  IMU  fields_updated & 0x3F == 0x3F  xgyro, ygyro, zgyro, xacc, yacc, zacc, id
  MAG  fields_updated & 0x1C0 == 0x1C0  xmag, ymag, zmag
RAW_IMU
  accel  {x,y,z} (1)  {x,y,z}acc * (GRAVITY * 1e-3)
  gyro  {x,y,z} (1)  {x,y,z}gyro * 1e-3
  accel-instances  {x,y,z}  {x,y,z}acc * (GRAVITY * 1e-3)
  gyro-instances  {x,y,z}  {x,y,z}gyro * 1e-3
  mag  compass 1  norm(xmag, ymag, zmag) * 1e-3
SCALED_IMU
  IMU  all  xgyro * 1e-3, ygyro * 1e-3, zgyro * 1e-3, \
    xacc * (GRAVITY * 1e-3), yacc * (GRAVITY * 1e-3), zacc * (GRAVITY * 1e-3)
SCALED_IMU2
  accel-instances  {x,y,z} 2  {x,y,z}acc * (GRAVITY * 1e-3)
  gyro-instances  {x,y,z} 2  {x,y,z}gyro * 1e-3
  mag  compass 2  norm(xmag, ymag, zmag) * 1e-3
  IMU#1  all  xgyro * 1e-3, ygyro * 1e-3, zgyro * 1e-3, \
    xacc * (GRAVITY * 1e-3), yacc * (GRAVITY * 1e-3), zacc * (GRAVITY * 1e-3)
SCALED_IMU3
  accel-instances  {x,y,z} 3  {x,y,z}acc * (GRAVITY * 1e-3)
  gyro-instances  {x,y,z} 3  {x,y,z}gyro * 1e-3
  mag  compass 3  norm(xmag, ymag, zmag) * 1e-3
  IMU#2  all  xgyro * 1e-3, ygyro * 1e-3, zgyro * 1e-3, \
    xacc * (GRAVITY * 1e-3), yacc * (GRAVITY * 1e-3), zacc * (GRAVITY * 1e-3)
SCALED_PRESSURE
  baro  barometer  press_abs
  temperature  barometer  temperature * 1e-2
VIBRATION
  vibration  {x,y,z}  vibration_{x,y,z}
  clipping  accelerometer {1,2,3}  clipping_{0,1,2}
SYS_STATUS
  battery-voltage  SYS_STATUS  known(voltage_battery, 65535) * 1e-3
  battery-current  SYS_STATUS  known(current_battery, -1) * 1e-2
  battery-remaining  SYS_STATUS  known(battery_remaining, -1)
  load  processor  load * 0.1
  link-drop  packets dropped  drop_rate_comm * 1e-2
BATTERY_STATUS
  battery-voltage  BATTERY_STATUS  summed(voltages)
  battery-remaining  BATTERY_STATUS  known(battery_remaining, -1)
  battery-cells  cell {1..10}  used(voltages[{0..9}], 1e-3)
POWER_STATUS
  board-voltage  Vcc  Vcc * 1e-3
  board-voltage  servo rail  used(Vservo, 1e-3)
HWSTATUS
  board-voltage  board  used(Vcc, 1e-3)
RADIO_STATUS
  radio  signal  known(rssi, 255)
  radio  remote signal  known(remrssi, 255)
  radio  noise  known(noise, 255)
  radio  remote noise  known(remnoise, 255)
HIL_ACTUATOR_CONTROLS
  actuators  motor {1..8}  used(controls[{0..7}])
  COMMAND  all  twelve(controls), HIL_ACTUATOR_CONTROLS
SERVO_OUTPUT_RAW
  outputs  output {1..8}  used(servo{1..8}_raw)
  COMMAND  port == 0  stack(servo1_raw, servo2_raw, servo3_raw, servo4_raw, servo5_raw, \
    servo6_raw, servo7_raw, servo8_raw, servo9_raw, servo10_raw, servo11_raw, \
    servo12_raw) * 1e-3, OUTPUTS
ACTUATOR_OUTPUT_STATUS
  COMMAND  all  twelve(actuator) * 1e-3, OUTPUTS
RC_CHANNELS
  rc  channel {1..8}  used(chan{1..8}_raw)
ESC_TELEMETRY_1_TO_4
  rpm  motor {1..4}  used(rpm[{0..3}])
ESC_TELEMETRY_5_TO_8
  rpm  motor {5..8}  used(rpm[{0..3}])
ESC_STATUS
  rpm  motor {1..4}  used(rpm[{0..3}])
WIND
  wind  speed  speed
WIND_COV
  wind  speed  norm(wind_x, wind_y)
DISTANCE_SENSOR
  range  distance sensor  current_distance * 1e-2
  RANGE  orientation == 25  where((min_distance < current_distance) \
    & (current_distance < max_distance), current_distance * 1e-2, nan)
RANGEFINDER
  range  distance sensor  distance
MEMINFO
  memory  free  freemem / 1024
ODOMETRY
  VISION  norm(q[0], q[1], q[2], q[3]) > 0  x, y, z, to_ned(q, child_frame_id == 12, \
    stack(vx, vy, vz)), unit(q)
VISION_POSITION_ESTIMATE
  VISION  all  x, y, z, nan, nan, nan, quat(roll, pitch, yaw)
"""
)
