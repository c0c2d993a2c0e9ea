/* lanes.h - one spelling of elementary functions for `double` and for SIMD batches of `double`.
 *
 * The plant is a template over its scalar S. With S = double it is one robot; with
 * S = xsimd::batch<double, Arch> every lane is another parameter set over the same log. Comparisons
 * give a mask, and `select(mask, a, b)` replaces the `if` that lanes cannot share.
 */
#ifndef OMNISLIP_SIM_LANES_H
#define OMNISLIP_SIM_LANES_H

#include <cmath>
#include <limits>
#include <type_traits>
#include <xsimd/xsimd.hpp>

/* What is compiled once per instruction set stands in a namespace of its own for each, so that no
 * function compiled for a wide one can be linked into code for a narrow one. */
#ifdef OMNISLIP_ARCH
#define OMNISLIP_INSTRUCTION_SET OMNISLIP_ARCH
#else
#define OMNISLIP_INSTRUCTION_SET of_every_processor
#endif

namespace omnislip {
inline namespace OMNISLIP_INSTRUCTION_SET {

constexpr double kPi = 3.14159265358979323846;

template <class S>
struct LaneCount {
    static constexpr int value = static_cast<int>(S::size);
};
template <>
struct LaneCount<double> {
    static constexpr int value = 1;
};

inline double select(bool mask, double when_true, double when_false) {
    return mask ? when_true : when_false;
}

inline double lane(double value, int) {
    return value;
}
template <class T, class A>
double lane(const xsimd::batch<T, A> &value, int index) {
    return value.get(static_cast<std::size_t>(index));
}

/* The value whose lane k is `value(k)`. */
template <class S, class Value>
S from_lanes(Value &&value) {
    if constexpr (std::is_same<S, double>::value) {
        return value(0);
    } else {
        alignas(64) double spread[LaneCount<S>::value];
        for (int k = 0; k < LaneCount<S>::value; ++k)
            spread[k] = value(k);
        return S::load_aligned(spread);
    }
}

inline bool any_above(double value, double limit) {
    return !(value <= limit);
}
template <class T, class A>
bool any_above(const xsimd::batch<T, A> &value, double limit) {
    return !xsimd::all(value <= xsimd::batch<T, A>(limit));
}

/* Both at once: they share most of the work. */
inline void sine_cosine(double angle, double &sine, double &cosine) {
    sine = std::sin(angle); /* the compiler makes one call of the two */
    cosine = std::cos(angle);
}
template <class T, class A>
void sine_cosine(const xsimd::batch<T, A> &angle, xsimd::batch<T, A> &sine,
                 xsimd::batch<T, A> &cosine) {
    const auto both = xsimd::sincos(angle);
    sine = both.first;
    cosine = both.second;
}

/* (2/pi) atan x, within two units of the last digit. It is most of what a step costs, and the arc
 * tangent of xsimd takes three divisions. For x > 0, with |t| <= tan(pi/8):
 *
 *   atan x = atan t,  pi/4 + atan t with t = (x-1)/(x+1),  or pi/2 + atan t with t = -1/x
 *   atan t = t - t z p(z),  z = t^2
 *
 * p is the polynomial of FreeBSD's msun (s_atan.c), summed in pairs that do not wait for each
 * other. As a call it would load its constants for every wheel anew. */
template <class A>
[[gnu::always_inline]] inline xsimd::batch<double, A> atan_in_right_angles(
    const xsimd::batch<double, A> &x) {
    using S = xsimd::batch<double, A>;
    constexpr double kTanPi8 = 0.41421356237309505, kTan3Pi8 = 2.414213562373095;
    const S sign = xsimd::bitofsign(x), size = x ^ sign;
    const auto small = size < S(kTanPi8);
    const auto large = size > S(kTan3Pi8);
    const S above = select(small, size, select(large, S(-1.0), size - S(1.0)));
    const S below = select(small, S(1.0), select(large, size, size + S(1.0)));
    const S begin = select(small, S(0.0), select(large, S(1.0), S(0.5)));
    const S t = above / below, z = t * t, z2 = z * z, z4 = z2 * z2;
    const S p0 = (S(3.33333333333329318027e-01) - z * S(1.99999999998764832476e-01)) +
                 z2 * (S(1.42857142725034663711e-01) - z * S(1.11111104054623557880e-01));
    const S p4 = (S(9.09088713343650656196e-02) - z * S(7.69187620504482999495e-02)) +
                 z2 * (S(6.66107313738753120669e-02) - z * S(5.83357013379057348645e-02));
    const S p8 = (S(4.97687799461593236017e-02) - z * S(3.65315727442169155270e-02)) +
                 z2 * S(1.62858201153657823623e-02);
    const S turned = S(2.0 / kPi) * t;
    return ((begin + turned) - turned * z * (p0 + z4 * (p4 + z4 * p8))) ^ sign;
}

/* Sine and cosine of angles near one for which they are known, to the last digit but one. */
template <class S>
class NearbyAngle {
  public:
    /* Makes ready for angles near this one. Those of a lane do not depend on the other lanes. */
    void follow(const S &angle) {
        using std::abs;
        const S away = abs(angle - angle_); /* no number at first */
        if (!any_above(away, kNear_rad))
            return;
        S sine, cosine;
        sine_cosine(angle, sine, cosine);
        const auto near = away <= S(kNear_rad);
        angle_ = select(near, angle_, angle);
        sine_ = select(near, sine_, sine);
        cosine_ = select(near, cosine_, cosine);
    }
    /* Taylor series: within 0.1 rad their first term left out is below 3e-18. */
    void operator()(const S &angle, S &sine, S &cosine) const {
        const S d = angle - angle_, d2 = d * d;
        if (any_above(d2, 0.01)) {
            sine_cosine(angle, sine, cosine);
            return;
        }
        const S sine_d =
            d * (S(1) - d2 * (S(1.0 / 6) -
                              d2 * (S(1.0 / 120) - d2 * (S(1.0 / 5040) - d2 * S(1.0 / 362880)))));
        const S less =
            d2 * (S(1.0 / 2) -
                  d2 * (S(1.0 / 24) -
                        d2 * (S(1.0 / 720) - d2 * (S(1.0 / 40320) - d2 * S(1.0 / 3628800)))));
        sine = sine_ + (cosine_ * sine_d - sine_ * less);
        cosine = cosine_ - (sine_ * sine_d + cosine_ * less);
    }

  private:
    static constexpr double kNear_rad = 0.05; /* a step turns by less than as much again */

    S angle_ = S(std::numeric_limits<double>::quiet_NaN()), sine_ = S(0.0), cosine_ = S(1.0);
};

/* Values of the wheels that are computed at once: all four doubles where the registers are as wide,
 * else pairs, which every processor has; or one wheel of lanes. */
template <class S>
struct LotOf {
    using Type = S;
    static constexpr int kWheels = 1;
};
template <>
struct LotOf<double> {
#if defined(__AVX2__)
    using Type = xsimd::batch<double, xsimd::avx2>;
#elif defined(__x86_64__)
    using Type = xsimd::batch<double, xsimd::sse2>;
#else
    using Type = xsimd::batch<double, xsimd::neon64>;
#endif
    static constexpr int kWheels = static_cast<int>(Type::size);
};

/* Reads and writes the wheels from `values` on. */
template <class S>
typename LotOf<S>::Type lot(const S *values) {
    if constexpr (std::is_same<S, double>::value)
        return LotOf<S>::Type::load_unaligned(values);
    else
        return *values;
}
template <class S>
void put(const typename LotOf<S>::Type &lot, S *values) {
    if constexpr (std::is_same<S, double>::value)
        lot.store_unaligned(values);
    else
        *values = lot;
}
template <class S>
S total(const typename LotOf<S>::Type &lot) {
    if constexpr (std::is_same<S, double>::value)
        return xsimd::hadd(lot);
    else
        return lot;
}

/* A place in any array of states: the wheels from i on, and a single value. */
template <class S>
struct LotAt {
    int i;
    typename LotOf<S>::Type operator()(const S *values) const {
        return lot(values + i);
    }
    void put(const typename LotOf<S>::Type &lot, S *values) const {
        omnislip::put(lot, values + i);
    }
};
template <class S>
struct OneAt {
    int i;
    const S &operator()(const S *values) const {
        return values[i];
    }
    void put(const S &value, S *values) const {
        values[i] = value;
    }
};

template <class S>
S sign_of(const S &x) {
    return select(x < S(0.0), S(-1.0), select(x > S(0.0), S(1.0), S(0.0)));
}

}  // namespace OMNISLIP_INSTRUCTION_SET
}  // namespace omnislip

#endif
