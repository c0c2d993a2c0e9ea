/* binding.h - what the files of the Python module share. */
#ifndef OMNISLIP_SIM_BINDING_H
#define OMNISLIP_SIM_BINDING_H

#include <nanobind/nanobind.h>

#include <map>
#include <string>
#include <vector>

#include "user_terms.h"

namespace omnislip {

using Numbers = std::map<std::string, double>;

/* A robot as RobotPlant takes it: parameter set, and the user's own effects, which `list` points
 * to.
 */
struct RobotParameters {
    std::vector<double> values;
    std::vector<UserTerm> terms;
    UserTermList list() const {
        return {terms.data(), static_cast<int>(terms.size())};
    }
};

/* From the keys of a model file and its effects, one dict each. Throws std::invalid_argument for an
 * unknown key, effect, parameter or wheel. */
RobotParameters robot_parameters(const Numbers &parameters, const nanobind::list &effects,
                                 const nanobind::list &user_effects);

/* Adds the virtual robot and the tables of its protocol to the module. */
void bind_link(nanobind::module_ &m);

}  // namespace omnislip

#endif
