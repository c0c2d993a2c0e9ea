/* active_effects.h - the effects that are switched on in a plant, called where they act.
 *
 * An effect that is switched off is never called, and a hook that no effect uses costs one test.
 */
#ifndef OMNISLIP_SIM_ACTIVE_EFFECTS_H
#define OMNISLIP_SIM_ACTIVE_EFFECTS_H

#include "effects.h"

namespace omnislip {
inline namespace OMNISLIP_INSTRUCTION_SET {

template <class S, int kMotors, Kind kKind>
class ActiveEffects {
  public:
    /* `slots`: values of all effects, which must outlive this; `active`: one flag per effect. The
     * active ones change the plant's constants. */
    void prepare(const S *slots, const bool *active, Constants<S, kMotors> &constants) {
        slots_ = slots;
        hooks_ = 0;
        for (int i = 0; i < kEffectCount; ++i)
            active_[i] = active[i];
        each([&](auto effect, const Values<S> &values) {
            hooks_ |= decltype(effect)::info.hooks;
            decltype(effect)::prepare(constants, values);
        });
    }

    /* Hooks that terms of the user need besides. */
    void add_hooks(unsigned hooks) {
        hooks_ |= hooks;
    }
    bool use(unsigned hook) const {
        return (hooks_ & hook) != 0;
    }

    /* `action(effect, values)` for the active effects that use `hook`. */
    template <class Action>
    void apply(unsigned hook, Action &&action) const {
        if (!use(hook))
            return;
        each([&](auto effect, const Values<S> &values) {
            if (decltype(effect)::info.hooks & hook)
                action(effect, values);
        });
    }

  private:
    template <class Action>
    void each(Action &&action) const {
        for_each_effect(kMotors, [&](auto effect, int index, int slot) {
            constexpr const EffectInfo &info = decltype(effect)::info;
            if constexpr ((info.kinds & kKind) != 0) {
                if (active_[index])
                    action(effect, Values<S>{slots_ + slot, effect_stride(info, kMotors)});
            }
        });
    }

    const S *slots_ = nullptr;
    bool active_[kEffectCount] = {};
    unsigned hooks_ = 0;
};

}  // namespace OMNISLIP_INSTRUCTION_SET
}  // namespace omnislip

#endif
