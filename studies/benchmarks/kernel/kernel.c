/* M1 of Ding et al. 2015, eqs. (4)-(15), for given sinkage: the limit that bayesterra's kernel is measured against.
 *
 * Written to be fast: one loop over the nodes without branches, which gcc vectorises with libmvec's exp, log and sin
 * (-O3 -march=native -ffast-math); cosines of half-angles from square roots, so that each node costs two sines, three
 * exponentials and one logarithm; one power of the normal stress for both parts of the arc. The nodes u and weights w
 * on (0, 1) are Gauss-Legendre in the cube root, and 32 of them are needed for 1e-9 everywhere in the prior box.
 */
#include <math.h>

#define NODES 32

typedef struct {
    double normal, pull, moment;
} forces;

static forces evaluate(const double *restrict theta, const double *restrict row, double z,
                       const double *restrict u, const double *restrict w)
{
    const double Ks = theta[0], n0 = theta[1], n1 = theta[2], c = theta[3], K = theta[5];
    const double c1 = theta[6], c2 = theta[7], c3 = theta[8];
    const double slip = row[0], exponent_slip = row[1], r = row[2], b = row[3], Rj = row[4], rs = row[5];
    const double n = n0 + n1 * exponent_slip, ratio = c1 + c2 * slip, drag = 1.0 - slip;
    const double cos1 = 1.0 - z / r, theta1 = acos(cos1), sin1 = sqrt(1.0 - cos1 * cos1);
    const double cosj = (r - z) / Rj, start = acos(cosj), sinj = sqrt(1.0 - cosj * cosj);
    const double theta2 = c3 * theta1, sin2 = sin(theta2), cos2 = cos(theta2), tan_phi = tan(theta[4]);
    const double front = 0.5 * theta1 * (1.0 - ratio), rear = 0.5 * theta1 * (ratio - c3);
    const double join1 = (start - theta1) - drag * (sinj - sin1), join2 = (start - theta2) - drag * (sinj - sin2);
    const double k = -rs / K, log_Ks_rn = log(Ks) + n * log(r);
    double sigma_cos = 0, sigma_sin = 0, tau_cos = 0, tau_sin = 0, tau_sum = 0;

    for (int i = 0; i < NODES; ++i) {
        const double a = front * u[i], sa = sin(a), ca = sqrt(1.0 - sa * sa);
        const double rise1 = 2.0 * sa * (sin1 * ca - cos1 * sa), fall1 = 2.0 * sa * (sin1 * sa + cos1 * ca);
        const double e = rear * u[i], se = sin(e), ce = sqrt(1.0 - se * se);
        const double rise2 = 2.0 * se * (cos2 * ce - sin2 * se), fall2 = 2.0 * se * (sin2 * ce + cos2 * se);
        const double sigma = w[i] * exp(log_Ks_rn + n * log(rise1));
        const double limit = c * w[i] + sigma * tan_phi;
        const double tau1 = front * (limit - limit * exp(k * (join1 + 2.0 * a - drag * fall1)));
        const double tau2 = rear * (limit - limit * exp(k * (join2 - 2.0 * e + drag * rise2)));
        const double cosine1 = cos1 + rise1, sine1 = sin1 - fall1, cosine2 = cos2 - fall2, sine2 = sin2 + rise2;
        sigma_cos += sigma * (front * cosine1 + rear * cosine2);
        sigma_sin += sigma * (front * sine1 + rear * sine2);
        tau_cos += tau1 * cosine1 + tau2 * cosine2;
        tau_sin += tau1 * sine1 + tau2 * sine2;
        tau_sum += tau1 + tau2;
    }
    return (forces){2.0 * b * (r * sigma_cos + rs * tau_sin), 2.0 * b * (rs * tau_cos - r * sigma_sin),
                    2.0 * b * rs * rs * tau_sum};
}

void evaluate_all(long pairs, const double *restrict theta, const double *restrict rows, const double *restrict z,
                  const double *restrict u, const double *restrict w, double *restrict out)
{
    for (long i = 0; i < pairs; ++i) {
        const forces f = evaluate(theta + 9 * i, rows + 6 * i, z[i], u, w);
        out[3 * i] = f.normal;
        out[3 * i + 1] = f.pull;
        out[3 * i + 2] = f.moment;
    }
}
