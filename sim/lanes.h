/* lanes.h - one spelling of elementary functions for `double` and for SIMD batches of `double`.
 *
 * The plant is a template over its scalar S. With S = double it is one robot; with
 * S = xsimd::batch<double, Arch> every lane is another parameter set over the same log. Comparisons
 * give a mask, and `select(mask, a, b)` replaces the `if` that lanes cannot share.
 */
#ifndef OMNISLIP_SIM_LANES_H
#define OMNISLIP_SIM_LANES_H

#include <cmath>
#include <type_traits>
#include <xsimd/xsimd.hpp>

namespace omnislip {

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

/* Arctangents of n values, in place; of doubles as many at once as every processor can. */
template <int n, class S>
void arctangents(S *values) {
    using std::atan;
    if constexpr (std::is_same<S, double>::value) {
        using Pair = xsimd::batch<S>;
        static_assert(n % static_cast<int>(Pair::size) == 0, "whole batches only");
        for (int i = 0; i < n; i += static_cast<int>(Pair::size))
            atan(Pair::load_unaligned(values + i)).store_unaligned(values + i);
    } else {
        for (int i = 0; i < n; ++i)
            values[i] = atan(values[i]);
    }
}

template <class S>
S sign_of(const S &x) {
    return select(x < S(0.0), S(-1.0), select(x > S(0.0), S(1.0), S(0.0)));
}

}  // namespace omnislip

#endif
