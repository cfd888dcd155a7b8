/* The arithmetic of one answer in C: the same sums, steps and rays that localize asks NumPy and OpenCV for.
 *
 * Only the bench compiles this. All images are row-major, with row 0 at the lowest y. */
#include <math.h>
#include <stdint.h>
#include <string.h>

/* Alg. 2 of a whole level: sums (K, H, W) of the image, shifted by (down, across) of each of N points. */
#define CORRELATE(name, kind)                                                                         \
    void name(const uint8_t *image, long height, long width, const int32_t *shift, long headings,      \
              long points, kind *restrict sums) {                                                      \
        memset(sums, 0, sizeof(kind) * headings * height * width);                                     \
        for (long k = 0; k < headings; k++)                                                            \
            for (long i = 0; i < points; i++) {                                                        \
                long down = shift[2 * (k * points + i)], across = shift[2 * (k * points + i) + 1];     \
                long top = down < 0 ? -down : 0, end = down > 0 ? height - down : height;              \
                long left = across < 0 ? -across : 0, right = across > 0 ? width - across : width;     \
                for (long r = top; r < end; r++) {                                                     \
                    const uint8_t *from = image + (r + down) * width + across;                         \
                    kind *to = sums + (k * height + r) * width;                                        \
                    for (long c = left; c < right; c++) to[c] += from[c];                              \
                }                                                                                      \
            }                                                                                          \
    }
CORRELATE(correlate_bytes, uint8_t)
CORRELATE(correlate_words, uint16_t)

/* Alg. 1, l. 4-6, at some poses: sums (M, 4) of the bytes of four images that lie `step` apart. */
void sums_under(const uint8_t *const *images, long step, const int64_t *offsets, long points, const int64_t *heading,
                const int64_t *base, long poses, int32_t *sums) {
    for (long m = 0; m < poses; m++) {
        const int64_t *offset = offsets + heading[m] * points;
        int32_t total[4] = {0, 0, 0, 0};
        for (long i = 0; i < points; i++)
            for (int j = 0; j < 4; j++) total[j] += images[j][step * (base[m] + offset[i])];
        memcpy(sums + 4 * m, total, sizeof total);
    }
}

/* Gauss-Newton with a Geman-McClure kernel: poses (M, 3) settle on the distance field (H * W + 1, 4). */
void refine(double *poses, long count, const float *xy, long points, const int16_t *field, long height, long width,
            double cell, double unit, double slope, const double *sigmas, long widths, long steps, const double *most,
            double damping) {
    for (long m = 0; m < count; m++) {
        double *pose = poses + 3 * m;
        for (long s = 0; s < widths * steps; s++) {
            float squared = sigmas[s / steps] * sigmas[s / steps];
            float co = cosf(pose[2]), si = sinf(pose[2]), x = pose[0], y = pose[1], per_cell = 1 / cell;
            float a00 = 0, a01 = 0, a02 = 0, a11 = 0, a12 = 0, a22 = 0, b0 = 0, b1 = 0, b2 = 0;
            for (long i = 0; i < points; i++) {
                float dx = co * xy[2 * i] - si * xy[2 * i + 1], dy = si * xy[2 * i] + co * xy[2 * i + 1];
                float u = (x + dx) * per_cell, v = (y + dy) * per_cell, column = floorf(u), row = floorf(v);
                int on = column >= 0 && column < width && row >= 0 && row < height;
                const int16_t *at = field + 4 * (on ? (long)row * width + (long)column : height * width);
                float gx = at[1] * (float)slope, gy = at[2] * (float)slope, turn = dx * gy - dy * gx;
                float off = at[0] * (float)unit + (float)cell * (gx * (u - column - 0.5f) + gy * (v - row - 0.5f));
                float weight = 1 + off * off / squared;
                weight = 1 / (weight * weight);
                a00 += weight * gx * gx, a01 += weight * gx * gy, a02 += weight * gx * turn;
                a11 += weight * gy * gy, a12 += weight * gy * turn, a22 += weight * turn * turn;
                b0 += weight * gx * off, b1 += weight * gy * off, b2 += weight * turn * off;
            }
            double A00 = a00 + damping * points, A11 = a11 + damping * points, A22 = a22 + damping * points;
            double c00 = A11 * A22 - (double)a12 * a12, c01 = (double)a02 * a12 - a01 * A22;
            double c02 = (double)a01 * a12 - A11 * a02, c11 = A00 * A22 - (double)a02 * a02;
            double c12 = (double)a01 * a02 - A00 * a12, c22 = A00 * A11 - (double)a01 * a01;
            double det = A00 * c00 + a01 * c01 + a02 * c02;
            double step[3] = {(c00 * b0 + c01 * b1 + c02 * b2) / det, (c01 * b0 + c11 * b1 + c12 * b2) / det,
                              (c02 * b0 + c12 * b1 + c22 * b2) / det};
            for (int j = 0; j < 3; j++) pose[j] -= fmax(-most[j], fmin(most[j], step[j]));
        }
    }
}

/* Sphere tracing: cells from (x, y) along (u, v) to the border of the first occupied cell, inf beyond `reach`. */
void cast(const float *distance, long height, long width, const float *start, const float *along, const float *reach,
          long rays, float *met) {
    for (long i = 0; i < rays; i++) {
        float x = start[2 * i], y = start[2 * i + 1], u = along[2 * i], v = along[2 * i + 1], t = 0;
        met[i] = INFINITY;
        while (t <= reach[i]) {
            float px = x + t * u, py = y + t * v, column = floorf(px), row = floorf(py);
            if (column < 0 || column >= width || row < 0 || row >= height) break;
            float far = distance[(long)row * width + (long)column];
            if (far == 0) {
                met[i] = t;
                break;
            }
            float across = u ? (column + (u > 0) - px) / u : 1e30f, down = v ? (row + (v > 0) - py) / v : 1e30f;
            float step = fmaxf(far - 1.41421356f, fminf(across, down));
            t += step + 1.0f / 128;
        }
    }
}
