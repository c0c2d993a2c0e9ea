/* link_binding.cpp - the virtual robot, and the tables of the serial protocol as the firmware has
 * them: the same .def files, compiled in. */
#include <nanobind/nanobind.h>
#include <nanobind/stl/map.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <stdexcept>

#include "binding.h"
#include "virtual_robot.h"

namespace nb = nanobind;
using namespace nb::literals;

namespace omnislip {
namespace {

/* ------------------------------------------------------------------ tables */

nb::list requests() {
    nb::list rows;
#define REQUEST(name, code, bytes, more, fields, answer, description) \
    rows.append(nb::make_tuple(#name, code, fields, answer, description));
#include "firmware/messages.def"
    return rows;
}

nb::list events() {
    nb::list rows;
#define EVENT(name, code, fields, description) \
    rows.append(nb::make_tuple(#name, code, fields, description));
#include "firmware/messages.def"
    return rows;
}

nb::list results() {
    nb::list rows;
#define RESULT(name, description) rows.append(nb::make_tuple(#name, description));
#include "firmware/messages.def"
    return rows;
}

nb::list store_statuses() {
    nb::list rows;
#define STORE_STATUS(name, description) rows.append(nb::make_tuple(#name, description));
#include "firmware/messages.def"
    return rows;
}

nb::list signals() {
    nb::list rows;
#define SIGNAL(name, type, unit, q_bits, expression, description) \
    rows.append(nb::make_tuple(#name, #type, #unit, q_bits, description));
#include "firmware/telemetry.def"
#undef SIGNAL
    return rows;
}

nb::list parameter_rows() {
    nb::list rows;
#define PARAMETER(name, unit, q_bits, minimum, maximum, initial, description) \
    rows.append(nb::make_tuple(#name, #unit, q_bits, minimum, maximum, initial, description));
#include "firmware/parameters.def"
#undef PARAMETER
    return rows;
}

nb::list states() {
    nb::list rows;
#define SUPERVISOR_STATE(state, bridges, ready, arm, disarm, command, stop, clear, description) \
    rows.append(nb::make_tuple(#state, description));
#define SUPERVISOR_FAULT(fault, recovery, description)
#include "firmware/supervisor.def"
#undef SUPERVISOR_STATE
#undef SUPERVISOR_FAULT
    return rows;
}

nb::list faults() {
    nb::list rows;
#define SUPERVISOR_STATE(state, bridges, ready, arm, disarm, command, stop, clear, description)
#define SUPERVISOR_FAULT(fault, recovery, description) \
    rows.append(nb::make_tuple(#fault, #recovery, description));
#include "firmware/supervisor.def"
#undef SUPERVISOR_STATE
#undef SUPERVISOR_FAULT
    return rows;
}

static_assert(CONTROL_LIMIT_SPEED == 1 && CONTROL_LIMIT_ACCELERATION == 2 &&
                  CONTROL_LIMIT_TRACTION == 3 && CONTROL_LIMIT_VOLTAGE == 4,
              "names of limits");
static_assert(CONTROL_MODE_VELOCITY == 1 && CONTROL_MODE_POSE == 2 && CONTROL_MODE_DUTY == 3,
              "names of modes");
static_assert(HAL_RESET_WATCHDOG == 1, "names of reset causes");

template <int Count>
nb::list names(const char *const (&given)[Count]) {
    nb::list list;
    for (const char *name : given)
        list.append(name);
    return list;
}

nb::dict link_tables() {
    nb::dict tables;
    tables["version"] = LINK_VERSION;
    tables["answer"] = LINK_ANSWER;
    tables["event"] = LINK_EVENT;
    tables["telemetry"] = LINK_TELEMETRY;
    tables["streams"] = TELEMETRY_STREAMS;
    tables["signals_per_stream"] = TELEMETRY_SIGNALS_MAX;
    tables["content_max"] = FRAME_CONTENT_MAX;
    tables["first_tunable"] = static_cast<int>(PARAMETER_FIRST_TUNABLE);
    tables["requests"] = requests();
    tables["results"] = results();
    tables["events"] = events();
    tables["store_statuses"] = store_statuses();
    tables["signals"] = signals();
    tables["parameters"] = parameter_rows();
    tables["states"] = states();
    tables["faults"] = faults();
    tables["limits"] = names({"NONE", "SPEED", "ACCELERATION", "TRACTION", "VOLTAGE"});
    tables["modes"] = names({"IDLE", "VELOCITY", "POSE", "DUTY"});
    tables["reset_causes"] = names({"POWER_ON", "WATCHDOG"});
    return tables;
}

/* ------------------------------------------------------------------ virtual robot */

nb::bytes pass_time(VirtualRobot &robot, long ticks, const nb::bytes &sent) {
    if (ticks < 0)
        throw std::invalid_argument("ticks must not be negative");
    const auto *begin = static_cast<const std::uint8_t *>(sent.data());
    const std::vector<std::uint8_t> bytes(begin, begin + sent.size());
    std::vector<std::uint8_t> delivered;
    {
        nb::gil_scoped_release release;
        delivered = robot.advance(ticks, bytes);
    }
    return nb::bytes(delivered.data(), delivered.size());
}

nb::list commands(const VirtualRobot &robot) {
    nb::list list;
    for (const HeldCommand &held : robot.commands()) {
        list.append(nb::make_tuple(held.tick, static_cast<int>(held.mode),
                                   std::vector<int>(held.value.begin(), held.value.end())));
    }
    return list;
}

nb::dict truth(const VirtualRobot &robot) {
    const double *x = robot.body().state();
    nb::dict result;
    result["pose"] = std::vector<double>(x + RobotLayout::kPose, x + RobotLayout::kPose + 3);
    result["velocity"] =
        std::vector<double>(x + RobotLayout::kVelocity, x + RobotLayout::kVelocity + 3);
    return result;
}

std::vector<int> parameters_held(const VirtualRobot &robot) {
    const i16 *value = robot.firmware().settings.value;
    return std::vector<int>(value, value + PARAMETER_COUNT);
}

nb::dict sent_by(const VirtualRobot &robot) {
    const telemetry &told = robot.firmware().told;
    nb::dict result;
    std::vector<int> streams;
    for (const telemetry_stream &stream : told.stream)
        streams.push_back(stream.sequence);
    result["stream_sequences"] = streams;
    result["event_sequence"] = told.event_sequence;
    result["bad_frames"] = told.counters.bad_frames;
    result["bytes_lost"] = told.counters.bytes_lost;
    result["answers_lost"] = told.counters.answers_lost;
    result["samples_lost"] = told.counters.samples_lost;
    return result;
}

}  // namespace

void bind_link(nb::module_ &m) {
    m.def("link_tables", &link_tables, "The tables of the serial protocol: a dict of lists.");
    nb::class_<VirtualRobot>(m, "VirtualRobot",
                             "Firmware, plant, serial line and EEPROM; see virtual_robot.h.")
        .def(
            "__init__",
            [](VirtualRobot *self, const Numbers &parameters, const nb::list &effects,
               const std::vector<std::uint16_t> &store, const nb::list &user_effects, double step_s,
               bool on_board) {
                const RobotParameters model = robot_parameters(parameters, effects, user_effects);
                new (self) VirtualRobot(model.values, model.terms, store, step_s,
                                        on_board ? Carrier::kBoard : Carrier::kPlant);
            },
            "parameters"_a, "effects"_a, "store"_a = std::vector<std::uint16_t>(),
            "user_effects"_a = nb::list(), "step_s"_a = 1e-3, "on_board"_a = false,
            "on_board: through the drivers on the virtual LF2407A instead of the stub HAL.")
        .def("advance", &pass_time, "ticks"_a, "sent"_a = nb::bytes("", 0),
             "Puts bytes on the line, lets ticks of 1 ms pass, returns the bytes delivered.")
        .def_prop_ro("ticks", &VirtualRobot::ticks)
        .def_prop_ro("store", &VirtualRobot::store, "The words of the EEPROM.")
        .def_prop_ro("store_writes", &VirtualRobot::store_writes)
        .def_prop_ro("commands", &commands,
                     "Changes of the command in the last advance: (tick, mode, six raw values).")
        .def_prop_ro("parameters", &parameters_held, "Raw parameter values by id.")
        .def_prop_ro("counters", &sent_by, "Sequences and counters of the link.")
        .def_prop_ro("truth", &truth,
                     "pose (m, m, rad) and velocity (m/s, m/s, rad/s) as they are.");
}

}  // namespace omnislip
