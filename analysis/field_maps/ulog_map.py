"""Field map of PX4's topics, named as in its message definitions; later lines of a kind of sample
are those of older versions.

Innovations with their gates: a measurement is rejected if innovation^2 > gate^2 * variance; the
gates are parameters (EKF2_GPS_P_GATE and so on, in standard deviations), the variances are logged.
"""

from analysis.field_maps.field_map import read_map

ULOG = read_map(
    r"""
vehicle_attitude
  {roll,pitch,yaw}  ATTITUDE  euler(q)[{0,1,2}]
  ATTITUDE  all  q, 1, ATTITUDE_QUATERNION
vehicle_attitude_setpoint
  {roll,pitch,yaw}  desired  euler(q_d)[{0,1,2}]
vehicle_attitude_groundtruth
  {roll,pitch,yaw}  truth  euler(q)[{0,1,2}]
estimator_attitude
  instance-{roll,pitch,yaw}  instance  euler(q)[{0,1,2}]
vehicle_angular_velocity
  rate-{roll,pitch,yaw}  actual  xyz[{0,1,2}] * DEG
vehicle_rates_setpoint
  rate-{roll,pitch,yaw}  desired  {roll,pitch,yaw} * DEG
vehicle_global_position
  altitude  estimate  altitude_msl_m
  track  estimate  latitude_deg, longitude_deg, altitude_msl_m
vehicle_global_position_groundtruth
  track  truth  latitude_deg, longitude_deg, altitude_msl_m
vehicle_local_position
  height  estimate  -z
  speed  ground  norm(vx, vy)
  climb  estimate  -vz
  velocity-{north,east,down}  estimate  v{x,y,z}
  position-{north,east,down}  estimate  {x,y,z}
vehicle_local_position_setpoint
  height  desired  -z
  velocity-{north,east,down}  desired  v{x,y,z}
  position-{north,east,down}  desired  {x,y,z}
vehicle_local_position_groundtruth
  climb  truth  -vz
  height  truth  -z
  velocity-{north,east,down}  truth  v{x,y,z}
  position-{north,east,down}  truth  {x,y,z}
estimator_local_position
  instance-down  instance  z
airspeed_validated
  speed  air  calibrated_airspeed_m_s
wind
  wind  speed  norm(windspeed_north, windspeed_east)
estimator_status
  ratio  velocity  vel_test_ratio
  ratio  horizontal position  pos_test_ratio
  ratio  vertical position  hgt_test_ratio
  ratio  magnetometer  mag_test_ratio
  ratio  heading  hdg_test_ratio
  ratio  airspeed  tas_test_ratio
  accuracy  horizontal  accuracy(pos_horiz_accuracy)
  accuracy  vertical  pos_vert_accuracy
  flag  GPS glitch  bit(solution_status_flags, 10)
  flag  accelerometer error  bit(solution_status_flags, 11)
  warn  GPS fix rejected  bit(gps_check_fail_flags, 0)
  warn  GPS satellites rejected  bit(gps_check_fail_flags, 1)
  warn  GPS dilution rejected  bit(gps_check_fail_flags, 2)
  warn  GPS {horizontal,vertical,speed} accuracy rejected  bit(gps_check_fail_flags, {3..5})
  warn  GPS {horizontal,vertical} drift rejected  bit(gps_check_fail_flags, {6,7})
  warn  GPS {horizontal,vertical} speed rejected  bit(gps_check_fail_flags, {8,9})
  flag  velocity rejected  bit(innovation_check_flags, 0)
  flag  {horizontal,vertical} position rejected  bit(innovation_check_flags, {1,2})
  flag  compass {x,y,z} rejected  bit(innovation_check_flags, {3..5})
  flag  yaw rejected  bit(innovation_check_flags, 6)
  flag  airspeed rejected  bit(innovation_check_flags, 7)
estimator_aid_src_{baro,gnss,rng,ev}_hgt
  rejected  {baro,GNSS,distance sensor,vision} height rejected  innovation_rejected
estimator_aid_src_{gnss,ev}_pos
  rejected  {GNSS,vision} position rejected  innovation_rejected
estimator_aid_src_{gnss,ev}_vel
  rejected  {GNSS,vision} velocity rejected  innovation_rejected
estimator_aid_src_{gnss,ev}_yaw
  rejected  {GNSS,vision} heading rejected  innovation_rejected
estimator_aid_src_{mag,mag_heading}
  rejected  {compass,compass heading} rejected  innovation_rejected
estimator_aid_src_{airspeed,optical_flow}
  rejected  {airspeed,optical flow} rejected  innovation_rejected
estimator_sensor_bias
  gyro-bias  {x,y,z}  gyro_bias[{0,1,2}]
  accel-bias  {x,y,z}  accel_bias[{0,1,2}]
estimator_innovations
  innovation-position  {north,east}  used(gps_hpos[{0,1}])
  innovation-velocity  {north,east}  used(gps_hvel[{0,1}])
  innovation-velocity  down  used(gps_vvel)
  innovation-height  {baro,GPS}  used({baro_vpos,gps_vpos})
  innovation-heading  heading  used(heading * DEG)
  innovation-mag  {x,y,z}  used(mag_field[{0,1,2}])
  innovation-airspeed  airspeed  used(airspeed)
estimator_innovation_variances first
  innovation-position  gate {north,east}  used(EKF2_GPS_P_GATE * sqrt(gps_hpos[{0,1}]))
  innovation-velocity  gate {north,east}  used(EKF2_GPS_V_GATE * sqrt(gps_hvel[{0,1}]))
  innovation-velocity  gate down  used(EKF2_GPS_V_GATE * sqrt(gps_vvel))
  innovation-height  gate baro  used(EKF2_BARO_GATE * sqrt(baro_vpos))
  innovation-height  gate GPS  used(EKF2_GPS_P_GATE * sqrt(gps_vpos))
  innovation-heading  gate heading  used(EKF2_HDG_GATE * DEG * sqrt(heading))
  innovation-mag  gate {x,y,z}  used(EKF2_MAG_GATE * sqrt(mag_field[{0,1,2}]))
  innovation-airspeed  gate airspeed  used(EKF2_TAS_GATE * sqrt(airspeed))
failsafe_flags
  failsafe  attitude invalid  attitude_invalid
  failsafe  {local,global} position invalid  {local,global}_position_invalid
  failsafe  gcs connection lost  gcs_connection_lost
  failsafe  manual control signal lost  manual_control_signal_lost
  failsafe  battery unhealthy  battery_unhealthy
  failsafe  geofence breached  geofence_breached
  failsafe  mission failure  mission_failure
  failsafe  wind limit exceeded  wind_limit_exceeded
  failsafe  fd critical failure  fd_critical_failure
  failsafe  fd imbalanced prop  fd_imbalanced_prop
  failsafe  fd motor failure  fd_motor_failure
  failsafe  local position accuracy low  local_position_accuracy_low
vehicle_gps_position
  altitude  GPS  altitude_msl_m
  speed  GPS  vel_m_s
  gps-satellites  GPS  satellites_used
  gps-fix  GPS  fix_type
  gps-accuracy  horizontal  accuracy(eph)
  gps-accuracy  vertical  accuracy(epv)
  gps-accuracy  speed, m/s  s_variance_m_s
  gps-dilution  {hdop,vdop}  where({hdop,vdop} < 99, {hdop,vdop}, nan)
  gps-noise  jamming indicator  jamming_indicator
  gps-noise  noise per ms  noise_per_ms
  gps-noise  spoofing state  spoofing_state
  gps-gain  automatic gain control  automatic_gain_control
  track  GPS  latitude_deg, longitude_deg, altitude_msl_m
  FIX  all  latitude_deg, longitude_deg, altitude_msl_m, vel_n_m_s, vel_e_m_s, vel_d_m_s, \
    fix_type, satellites_used, eph, epv, GPS_RAW_INT
sensor_gps
  FIX  all  latitude_deg, longitude_deg, altitude_msl_m, vel_n_m_s, vel_e_m_s, vel_d_m_s, \
    fix_type, satellites_used, eph, epv, GPS_RAW_INT
satellite_info
  gps-cn0  strongest  rank(snr, 1)
  gps-cn0  fourth strongest  rank(snr, 4)
vehicle_magnetometer
  MAG  all  magnetometer_ga
sensor_mag
  mag  compass  norm(x, y, z)
  MAG  all  x, y, z
sensor_combined
  accel  {x,y,z}  accelerometer_m_s2[{0,1,2}]
  gyro  {x,y,z}  gyro_rad[{0,1,2}]
  IMU  all  gyro_rad, accelerometer_m_s2, 0
  MAG  all  magnetometer_ga
sensor_accel
  accel-instances  {x,y,z}  {x,y,z}
  temperature  IMU  temperature
sensor_gyro
  gyro-instances  {x,y,z}  {x,y,z}
sensors_status_imu
  accel-disagreement  IMU {1..4}  used(accel_inconsistency_m_s_s[{0..3}])
  gyro-disagreement  IMU {1..4}  used(gyro_inconsistency_rad_s[{0..3}])
vehicle_air_data
  baro  barometer  baro_pressure_pa * 0.01
  BARO  all  baro_pressure_pa, nan
sensor_baro
  temperature  barometer  temperature
  BARO  all  pascal(pressure), nan
differential_pressure
  AIRSPEED  all  differential_pressure_pa
  AIRSPEED  all  differential_pressure_filtered_pa
distance_sensor
  range  distance sensor  current_distance
  RANGE  all  current_distance
vehicle_imu_status
  vibration  accelerometer  accel_vibration_metric
  clipping  accelerometer  most(accel_clipping[0], accel_clipping[1], accel_clipping[2])
failure_detector_status
  imbalance  propellers  imbalanced_prop_metric
battery_status
  battery-voltage  battery  voltage_v
  battery-current  battery  known(current_a, -1)
  battery-remaining  battery  where(connected, 100 * remaining, nan)
  battery-cells  cell {1..14}  used(voltage_cell_v[{0..13}])
system_power
  board-voltage  5 V rail  above_0(voltage5v_v)
cpuload
  load  processor  load * 100
  load  memory  ram_usage * 100
telemetry_status
  radio  frames lost, %  rx_message_lost_rate
input_rc
  radio  RC signal  above_0(rssi)
  rc  channel {1..8}  used(values[{0..7}])
actuator_outputs
  outputs  output {1..12}  used(output[{0..11}])
  COMMAND  all  twelve(output) * 1e-3, OUTPUTS
actuator_motors
  actuators  motor {1..12}  control[{0..11}]
  COMMAND  all  twelve(control), OUTPUTS
actuator_servos
  servos  servo {1..8}  control[{0..7}]
vehicle_torque_setpoint
  torque  {roll,pitch,yaw}  xyz[{0,1,2}]
vehicle_thrust_setpoint
  throttle  thrust  100 * norm(xyz[0], xyz[1], xyz[2])
control_allocator_status
  unallocated  torque {roll,pitch,yaw}  unallocated_torque[{0,1,2}]
manual_control_setpoint
  sticks  {roll,pitch,yaw,throttle}  {roll,pitch,yaw,throttle}
esc_status
  rpm  motor {1..8}  used(esc[{0..7}].esc_rpm)
"""
)
# Standard deviations at which a measurement is rejected, by PX4's defaults.
GATES = {
    "EKF2_GPS_P_GATE": 5.0, "EKF2_GPS_V_GATE": 5.0, "EKF2_BARO_GATE": 5.0, "EKF2_HDG_GATE": 2.6,
    "EKF2_MAG_GATE": 3.0, "EKF2_TAS_GATE": 3.0,
}  # fmt: skip
