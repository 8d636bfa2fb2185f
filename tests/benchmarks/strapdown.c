/* The least that a strapdown INS can cost: quaternion, velocity and position from increments, no noise.
   Usage: strapdown SAMPLES; prints the processor time in seconds, and the final velocity. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

int main(int count, char **arguments) {
    long samples = count > 1 ? atol(arguments[1]) : 1000000;
    const double dt = 0.01, earth = 7.292115e-5, radius = 6.378e6, gravity = 9.797;
    double q[4] = {1, 0, 0, 0}, v[2] = {0, 0}, latitude = 0.6353, longitude = 0;
    clock_t begin = clock();
    for (long k = 0; k < samples; k++) {
        double s = sin(latitude), c = cos(latitude), r = 1e-9 * ((double)(k & 1023) - 511.5);
        double n[3] = {-v[1] / radius, earth * c + v[0] / radius, earth * s + v[0] * s / (c * radius)};
        double w[3] = {(r + n[0]) * dt, n[1] * dt, (n[2] - r) * dt};
        double f[3] = {1e-7 * r, -1e-7 * r, gravity};
        /* body rate minus rate of the navigation frame, as a rotation vector */
        double x = w[0] - n[0] * dt, y = w[1] - n[1] * dt, z = w[2] - n[2] * dt;
        double h = 0.25 * (x * x + y * y + z * z), a = 0.5 - h / 12, b = 1 - h / 2;
        double p[4] = {
            b * q[0] - a * (x * q[1] + y * q[2] + z * q[3]), b * q[1] + a * (x * q[0] + z * q[2] - y * q[3]),
            b * q[2] + a * (y * q[0] + x * q[3] - z * q[1]), b * q[3] + a * (z * q[0] + y * q[1] - x * q[2])};
        double e = 1.5 - 0.5 * (p[0] * p[0] + p[1] * p[1] + p[2] * p[2] + p[3] * p[3]);
        for (int i = 0; i < 4; i++) q[i] = e * p[i];
        double fe = (1 - 2 * (q[2] * q[2] + q[3] * q[3])) * f[0] + 2 * (q[1] * q[2] - q[0] * q[3]) * f[1]
                  + 2 * (q[1] * q[3] + q[0] * q[2]) * f[2];
        double fn = 2 * (q[1] * q[2] + q[0] * q[3]) * f[0] + (1 - 2 * (q[1] * q[1] + q[3] * q[3])) * f[1]
                  + 2 * (q[2] * q[3] - q[0] * q[1]) * f[2];
        double coriolis = 2 * earth * s + v[0] * s / (c * radius);
        double east = v[0] + (fe + coriolis * v[1]) * dt, north = v[1] + (fn - coriolis * v[0]) * dt;
        v[0] = east, v[1] = north;
        latitude += north * dt / radius, longitude += east * dt / (radius * c);
    }
    printf("%g %g %g\n", (double)(clock() - begin) / CLOCKS_PER_SEC, v[0] + v[1], longitude);
    return 0;
}
