"""Field map of ArduPilot's dataflash messages, named as in its log reference; those of old logs as
in its old versions.

Innovation test ratios (SV, SP, SH, SM, SVT): from 1 on a measurement is rejected. Bits of TS, the
timeouts, and of SS, `nav_filter_status`: AP_Nav_Common.h.
"""

from analysis.field_maps.field_map import read_map

# Of one type of estimator: status, innovations, states, and the suffix of its curves.
_ESTIMATOR = """
{status}
  variance  velocity{core}  SV
  variance  horizontal position{core}  SP
  variance  vertical position{core}  SH
  variance  compass{core}  SM
{status} first
  flag  position timeout  bit(TS, 0)
  flag  velocity timeout  bit(TS, 1)
  flag  height timeout  bit(TS, 2)
  flag  compass timeout  bit(TS, 3)
  flag  GPS glitch  bit(SS, 14)
  rejected  velocity rejected  SV >= 1
  rejected  position rejected  SP >= 1
  rejected  height rejected  SH >= 1
  rejected  compass rejected  SM >= 1
  rejected  airspeed rejected  SVT >= 1
{innovations}
  innovation-velocity  north{core}  IVN
  innovation-velocity  east{core}  IVE
  innovation-velocity  down{core}  IVD
  innovation-position  north{core}  IPN
  innovation-position  east{core}  IPE
  innovation-height  height{core}  IPD
  innovation-heading  heading{core}  IYAW
  innovation-mag  x{core}  IMX
  innovation-mag  y{core}  IMY
  innovation-mag  z{core}  IMZ
  innovation-airspeed  airspeed{core}  IVT
{states}
  instance-roll  core{core}  Roll
  instance-pitch  core{core}  Pitch
  instance-yaw  core{core}  wrapped(Yaw)
  instance-down  core{core}  PD
  gyro-bias  x{core}  GX
  gyro-bias  y{core}  GY
  gyro-bias  z{core}  GZ
"""
_ESTIMATORS = (
    ("XKF4", "XKF3", "XKF1", ""), ("NKF4", "NKF3", "NKF1", ""), ("NKF9", "NKF8", "NKF6", " 2"),
    ("EKF4", "EKF3", "EKF1", ""),
)  # fmt: skip
DATAFLASH = read_map(
    r"""
ATT first
  roll  {ATTITUDE,desired}  {Roll,DesRoll}
  pitch  {ATTITUDE,desired}  {Pitch,DesPitch}
  yaw  {ATTITUDE,desired}  wrapped({Yaw,DesYaw})
  ATTITUDE  all  quat(Roll / DEG, Pitch / DEG, Yaw / DEG), 1, ATTITUDE_QUATERNION
SIM first
  {roll,pitch}  truth  {Roll,Pitch}
  yaw  truth  wrapped(Yaw)
  altitude  truth  Alt
  track  truth  Lat, Lng, Alt
SIM2 first
  climb  truth  -VD
RATE first
  rate-{roll,pitch,yaw}  actual  {R,P,Y}
  rate-{roll,pitch,yaw}  desired  {R,P,Y}Des
PSCN first
  position-north  {estimate,desired}  {PN,TPN}
  velocity-north  {estimate,desired}  {VN,TVN}
PSCE first
  position-east  {estimate,desired}  {PE,TPE}
  velocity-east  {estimate,desired}  {VE,TVE}
PSCD first
  position-down  {estimate,desired}  {PD,TPD}
  velocity-down  {estimate,desired}  {VD,TVD}
GPS
  altitude  GPS  Alt
  speed  GPS  Spd
  gps-satellites  GPS  NSats
  gps-fix  GPS  Status
  gps-dilution  hdop  HDop
  track  GPS  Lat, Lng, Alt
  FIX  all  Lat, Lng, Alt, course(Spd, GCrs), VZ, Status, NSats, HAcc, VAcc, GPS_RAW_INT
GPA
  gps-dilution  vdop  VDop
  gps-accuracy  {horizontal,vertical}  accuracy({HAcc,VAcc})
  gps-accuracy  speed, m/s  SAcc
UBX1 first
  gps-noise  jamming indicator  jamInd
  gps-noise  noise per ms  noisePerMS
  gps-gain  automatic gain control  agcCnt
POS first
  altitude  estimate  Alt
  height  estimate  RelHomeAlt
  track  estimate  Lat, Lng, Alt
CTUN first
  height  {desired,controller,barometer}  {DAlt,Alt,BAlt}
  climb  {CTUN,desired}  {CRt,DCRt} * 0.01
  throttle  throttle  ThO * 100
  throttle  throttle  ThrOut * 0.1
ARSP first
  speed  air  Airspeed
  AIRSPEED  all  DiffPress
VIBE
  vibration  {x,y,z}  Vibe{X,Y,Z}
  clipping  accelerometer  Clip
VIBE first
  clipping  accelerometer {1,2,3}  Clip{0,1,2}
IMU
  accel-instances  {x,y,z}  Acc{X,Y,Z}
  gyro-instances  {x,y,z}  Gyr{X,Y,Z}
  temperature  IMU  T
  IMU  all  GyrX, GyrY, GyrZ, AccX, AccY, AccZ, 0
IMU first
  accel  {x,y,z}  Acc{X,Y,Z}
  gyro  {x,y,z}  Gyr{X,Y,Z}
MAG
  mag  compass  norm(MagX, MagY, MagZ) * 1e-3
  MAG  all  MagX * 1e-3, MagY * 1e-3, MagZ * 1e-3
BARO
  baro  barometer  Press * 0.01
  temperature  barometer  Temp
  BARO  all  Press, nan
BAT
  battery-voltage  battery  Volt
  battery-current  battery  Curr
  battery-remaining  battery  RemPct
CURR
  battery-voltage  battery  old_hundredths(Volt, Volt)
  battery-current  battery  old_hundredths(Curr, Volt)
CURR first
  board-voltage  Vcc  Vcc * 1e-3
BCL
  battery-cells  cell {1..12}  used(V{1..12}, 1e-3)
POWR first
  board-voltage  Vcc  Vcc
  board-voltage  servo rail  used(VServo)
  temperature  processor  used(MTemp)
PM first
  load  processor  Load * 0.1
  scheduler  long loops  100.0 * NLon / at_least(NLoop, 1.0)
  loop-time  longest loop  MaxT * 1e-3
  memory  free  Mem / 1024
RAD first
  radio  {signal,remote signal,noise,remote noise}  {RSSI,RemRSSI,Noise,RemNoise}
RCOU first
  outputs  output {1..8}  used(C{1..8})
  COMMAND  all  twelve(C_) * 1e-3, OUTPUTS
  COMMAND  all  twelve(Ch_) * 1e-3, OUTPUTS
RCIN first
  rc  channel {1..8}  used(C{1..8})
ESC
  rpm  motor  used(RPM)
RFND
  range  distance sensor  Dist
  RANGE  all  Dist
"""
    + "".join(
        _ESTIMATOR.format(status=status, innovations=innovations, states=states, core=core)
        for status, innovations, states, core in _ESTIMATORS
    )
)
