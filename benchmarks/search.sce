// The classical program in Scilab: 12 states by ode() at 0.01 s, sensors with noise, Heun, RMSE.
// Aerosonde of aerosonde-2012.yaml, trimmed flight at 35 m/s; prints tests and CPU seconds.
funcprot(0);
m = 13.5; g = 9.80665; rho = 1.225; S = 0.55; b = 2.8956; c = 0.18994;
Jx = 0.8244; Jy = 1.135; Jz = 1.759; Jxz = 0.1204; J = Jx*Jz - Jxz^2;
G = [Jxz*(Jx-Jy+Jz)/J, (Jz*(Jz-Jy)+Jxz^2)/J, Jz/J, Jxz/J, (Jz-Jx)/Jy, Jxz/Jy, ..
     ((Jx-Jy)*Jx+Jxz^2)/J, Jx/J];

function [f, n] = loads(x, d)
    Va = sqrt(x(4)^2 + x(5)^2 + x(6)^2); al = atan(x(6), x(4)); be = asin(x(5)/Va);
    Q = 0.5*rho*Va^2*S; p = b*x(10)/(2*Va); q = c*x(11)/(2*Va); r = b*x(12)/(2*Va);
    e1 = exp(-50*(al-0.4712)); e2 = exp(50*(al+0.4712));
    s = (1+e1+e2)/((1+e1)*(1+e2));
    L = Q*((1-s)*(0.28+3.45*al) + s*2*sign(al)*sin(al)^2*cos(al) - 0.36*d(1));
    D = Q*(0.0437 + (0.28+3.45*al)^2/(%pi*0.9*b^2/S));
    T = 0.5*rho*0.2027*((80*d(4))^2 - Va^2);
    f = [L*sin(al)-D*cos(al)+T; Q*(-0.98*be-0.17*d(3)); -D*sin(al)-L*cos(al)];
    n = [Q*b*(-0.12*be-0.26*p+0.14*r+0.08*d(2)+0.105*d(3)); ..
         Q*c*(-0.02338-0.38*al-3.6*q-0.5*d(1)); ..
         Q*b*(0.25*be+0.022*p-0.35*r+0.06*d(2)-0.032*d(3))];
endfunction

function dx = dynamics(t, x)
    [f, n] = loads(x, controls);
    sf = sin(x(7)); cf = cos(x(7)); st = sin(x(8)); ct = cos(x(8)); sy = sin(x(9)); cy = cos(x(9));
    u = x(4); v = x(5); w = x(6); p = x(10); q = x(11); r = x(12);
    dx = [ct*cy*u+(sf*st*cy-cf*sy)*v+(cf*st*cy+sf*sy)*w; ..
          ct*sy*u+(sf*st*sy+cf*cy)*v+(cf*st*sy-sf*cy)*w; -st*u+sf*ct*v+cf*ct*w; ..
          r*v-q*w-g*st+f(1)/m; p*w-r*u+g*ct*sf+f(2)/m; q*u-p*v+g*ct*cf+f(3)/m; ..
          p+(q*sf+r*cf)*st/ct; q*cf-r*sf; (q*sf+r*cf)/ct; ..
          G(1)*p*q-G(2)*q*r+G(3)*n(1)+G(4)*n(3); G(5)*p*r-G(6)*(p^2-r^2)+n(2)/Jy; ..
          G(7)*p*q-G(1)*q*r+G(4)*n(1)+G(8)*n(3)];
endfunction

function dx = inverse(x, y)
    sf = sin(x(1)); cf = cos(x(1)); st = sin(x(2)); ct = cos(x(2)); sy = sin(x(3)); cy = cos(x(3));
    u = x(4); v = x(5); w = x(6); p = y(1); q = y(2); r = y(3);
    dx = [p+(q*sf+r*cf)*st/ct; q*cf-r*sf; (q*sf+r*cf)/ct; ..
          y(4)+r*v-q*w-g*st; y(5)+p*w-r*u+g*ct*sf; y(6)+q*u-p*v+g*ct*cf; ..
          ct*cy*u+(sf*st*cy-cf*sy)*v+(cf*st*cy+sf*sy)*w; ..
          ct*sy*u+(sf*st*sy+cf*cy)*v+(cf*st*sy-sf*cy)*w; -st*u+sf*ct*v+cf*ct*w];
endfunction

function worst = one_test(duration)
    t = 0:0.01:duration; N = length(t);
    x0 = [0;0;-500; 35+rand(); rand()-0.5; 0.12; 0;0.0035;0; 0.1*(rand(3,1)-0.5)];
    X = ode(x0, 0, t, dynamics);
    Y = zeros(6, N);
    for k = 1:N
        Y(1:3,k) = X(10:12,k);
        Y(4:6,k) = loads(X(:,k), controls)/m;
    end
    Y(1:3,:) = Y(1:3,:) + 0.13*%pi/180*rand(3, N, "normal");
    Y(4:6,:) = Y(4:6,:) + 0.0245*rand(3, N, "normal");
    E = zeros(9, N); E(:,1) = [x0(7:9); x0(4:6); x0(1:3)];
    for k = 1:N-1
        k1 = inverse(E(:,k), Y(:,k));
        k2 = inverse(E(:,k) + 0.01*k1, Y(:,k+1));
        E(:,k+1) = E(:,k) + 0.005*(k1 + k2);
    end
    worst = max(sqrt(mean((E(1:3,:) - X(7:9,:)).^2, 2)));
endfunction

controls = [-0.0494; 0; 0; 0.464];
tests = 3;
timer();
for i = 1:tests
    worst = one_test(60);
end
seconds = timer();
mprintf("RESULT %d %.3f\n", tests, seconds);
