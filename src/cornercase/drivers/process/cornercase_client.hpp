// The other end of cornercase's protocol, for a driving function in C++17. Header-only, without other libraries.
//
//     #include "cornercase_client.hpp"
//
//     struct Aeb {
//         void start(const cornercase::Batch &batch) { reaction = batch.option("reaction", 0.3); }
//         void step(const cornercase::Step &step, cornercase::Controls &controls) {
//             const auto &gap = step.column("leader_gap"), &closing = step.column("leader_closing");
//             for (std::size_t row = 0; row < step.size(); ++row)
//                 controls.acceleration[row] = gap[row] < 1.5 * closing[row] ? -8.0 : 0.0;
//         }
//         double reaction;
//     };
//
//     int main() { return cornercase::serve(Aeb{}, {"leader_gap", "leader_closing"}); }
//
// All scenarios of a batch run together. `step.scenarios[row]` is the number of a row's scenario in the batch, by which
// a function keeps its state. It prints to stderr, as stdout is taken.

#ifndef CORNERCASE_CLIENT_HPP
#define CORNERCASE_CLIENT_HPP

#include <array>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <exception>
#include <limits>
#include <map>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#ifdef _WIN32
#include <fcntl.h>
#include <io.h>
#else
#include <unistd.h>
#endif

namespace cornercase {

constexpr int protocol_version = 1;

// A value of MessagePack: nil, a bool, a number, a text, binary data, an array or a map with texts as keys.
struct Value {
    enum class Kind { nil, boolean, number, text, binary, array, map };
    Kind kind = Kind::nil;
    double number = 0.0;
    std::string text;
    std::vector<Value> items;
    std::map<std::string, Value> fields;

    bool has(const std::string &name) const { return fields.count(name) != 0; }
    const Value &operator[](const std::string &name) const {
        auto found = fields.find(name);
        if (found == fields.end()) throw std::runtime_error("a message lacks '" + name + "'");
        return found->second;
    }
    std::vector<double> doubles() const {
        std::vector<double> values(text.size() / 8);
        for (std::size_t k = 0; k < values.size(); ++k) {
            std::uint64_t bits = 0;
            for (int byte = 7; byte >= 0; --byte) bits = bits << 8 | static_cast<unsigned char>(text[8 * k + byte]);
            std::memcpy(&values[k], &bits, 8);
        }
        return values;
    }
};

class Reader {
  public:
    explicit Reader(const std::string &content) : content_(content) {}

    Value read() {
        const unsigned type = byte();
        if (type < 0x80) return number(type);
        if (type < 0x90) return map(type & 15);
        if (type < 0xa0) return array(type & 15);
        if (type < 0xc0) return bytes(Value::Kind::text, type & 31);
        if (type >= 0xe0) return number(static_cast<int>(type) - 256);
        switch (type) {
        case 0xc0: return {};
        case 0xc2: case 0xc3: { Value value = number(type & 1); value.kind = Value::Kind::boolean; return value; }
        case 0xc4: return bytes(Value::Kind::binary, integer(1));
        case 0xc5: return bytes(Value::Kind::binary, integer(2));
        case 0xc6: return bytes(Value::Kind::binary, integer(4));
        case 0xca: { auto bits = static_cast<std::uint32_t>(integer(4)); float f; std::memcpy(&f, &bits, 4); return number(f); }
        case 0xcb: { auto bits = integer(8); double d; std::memcpy(&d, &bits, 8); return number(d); }
        case 0xcc: return number(static_cast<double>(integer(1)));
        case 0xcd: return number(static_cast<double>(integer(2)));
        case 0xce: return number(static_cast<double>(integer(4)));
        case 0xcf: return number(static_cast<double>(integer(8)));
        case 0xd0: return number(static_cast<std::int8_t>(integer(1)));
        case 0xd1: return number(static_cast<std::int16_t>(integer(2)));
        case 0xd2: return number(static_cast<std::int32_t>(integer(4)));
        case 0xd3: return number(static_cast<double>(static_cast<std::int64_t>(integer(8))));
        case 0xd9: return bytes(Value::Kind::text, integer(1));
        case 0xda: return bytes(Value::Kind::text, integer(2));
        case 0xdb: return bytes(Value::Kind::text, integer(4));
        case 0xdc: return array(integer(2));
        case 0xdd: return array(integer(4));
        case 0xde: return map(integer(2));
        case 0xdf: return map(integer(4));
        default: throw std::runtime_error("a message has a value of an unknown type");
        }
    }

  private:
    unsigned byte() {
        if (position_ >= content_.size()) throw std::runtime_error("a message is cut off");
        return static_cast<unsigned char>(content_[position_++]);
    }
    std::uint64_t integer(int length) {
        std::uint64_t value = 0;
        for (int k = 0; k < length; ++k) value = value << 8 | byte();
        return value;
    }
    static Value number(double value) {
        Value result;
        result.kind = Value::Kind::number;
        result.number = value;
        return result;
    }
    Value bytes(Value::Kind kind, std::uint64_t length) {
        if (length > content_.size() - position_) throw std::runtime_error("a message is cut off");
        Value result;
        result.kind = kind;
        result.text = content_.substr(position_, length);
        position_ += length;
        return result;
    }
    Value array(std::uint64_t length) {
        Value result;
        result.kind = Value::Kind::array;
        for (std::uint64_t k = 0; k < length; ++k) result.items.push_back(read());
        return result;
    }
    Value map(std::uint64_t length) {
        Value result;
        result.kind = Value::Kind::map;
        for (std::uint64_t k = 0; k < length; ++k) {
            std::string name = read().text;
            result.fields[name] = read();
        }
        return result;
    }
    const std::string &content_;
    std::size_t position_ = 0;
};

class Writer {
  public:
    std::string content;

    Writer &map(std::size_t length) { return head(0xde, length, 2); }
    Writer &array(std::size_t length) { return head(0xdd, length, 4); }
    Writer &text(const std::string &value) {
        head(0xdb, value.size(), 4);
        content += value;
        return *this;
    }
    Writer &integer(std::uint64_t value) { return head(0xcf, value, 8); }
    Writer &number(double value) {
        std::uint64_t bits;
        std::memcpy(&bits, &value, 8);
        return head(0xcb, bits, 8);
    }
    Writer &doubles(const std::vector<double> &values) {
        head(0xc6, 8 * values.size(), 4);
        for (double value : values) {
            std::uint64_t bits;
            std::memcpy(&bits, &value, 8);
            for (int byte = 0; byte < 8; ++byte) content += static_cast<char>(bits >> 8 * byte & 255);
        }
        return *this;
    }

  private:
    Writer &head(unsigned type, std::uint64_t value, int length) {
        content += static_cast<char>(type);
        for (int byte = length - 1; byte >= 0; --byte) content += static_cast<char>(value >> 8 * byte & 255);
        return *this;
    }
};

// N concrete scenarios that run together, as the message `start` describes them.
struct Batch {
    std::size_t scenarios = 0;
    std::size_t size() const { return scenarios; }
    double time_step = 0.0;
    Value ego;                                              // name, object_type, length, wheelbase, max_steering, ...
    std::vector<Value> values;                              // parameter values of the scenario file, by scenario
    std::vector<std::uint64_t> seeds;                       // by scenario
    std::vector<double> friction;                           // by scenario
    std::map<std::string, std::vector<double>> parameters;  // own options that differ between scenarios
    Value options;                                          // own options

    double option(const std::string &name, double otherwise) const {
        if (!options.has(name)) return otherwise;
        const Value &given = options[name];
        if (given.kind == Value::Kind::text)
            throw std::runtime_error("the option " + name + " is '" + given.text + "', which is not a number");
        return given.number;
    }
    // The option in one scenario.
    double option(const std::string &name, double otherwise, std::size_t scenario) const {
        auto found = parameters.find(name);
        return found == parameters.end() ? option(name, otherwise) : found->second.at(scenario);
    }
};

// Another entity; its state is in columns.
struct Other {
    std::string name, object_type;
    double length, width, center_x;
};

// One time step of M scenarios.
struct Step {
    double time = 0.0, time_step = 0.0;
    std::vector<std::size_t> scenarios;                  // number of each row's scenario in the batch
    std::vector<Other> others;                           // the A other entities
    std::map<std::string, std::vector<double>> columns;  // M, M * A or M * K numbers, row by row
    std::map<std::string, std::vector<std::string>> signals;

    std::size_t size() const { return scenarios.size(); }
    const std::vector<double> &column(const std::string &name) const { return columns.at(name); }
    // The number of one of the other entities in one row, from a column (M, A).
    double of_other(const std::string &name, std::size_t row, std::size_t other) const {
        return columns.at(name).at(row * others.size() + other);
    }
};

// What is decided, by row; NaN where nothing is.
struct Controls {
    std::vector<double> acceleration, steering, throttle, brake, lane_change;
    std::map<std::size_t, std::array<std::vector<double>, 3>> trajectories;  // time, x and y
    std::map<std::size_t, std::string> failures;

    explicit Controls(std::size_t size)
        : acceleration(size, std::numeric_limits<double>::quiet_NaN()), steering(acceleration), throttle(acceleration),
          brake(acceleration), lane_change(size, 0.0) {}
};

class Connection {
  public:
    Connection() {
        std::fflush(stdout);
#ifdef _WIN32
        const int answers = _dup(1);
        _dup2(2, 1);
        _setmode(answers, _O_BINARY);
        _setmode(0, _O_BINARY);
        output_ = _fdopen(answers, "wb");
#else
        const int answers = dup(1);
        dup2(2, 1);
        output_ = fdopen(answers, "wb");
#endif
        // What the function prints comes at once, before a crash.
        std::setvbuf(stdout, nullptr, _IONBF, 0);
    }
    bool receive(Value &message) {
        unsigned char head[4];
        if (std::fread(head, 1, 4, stdin) < 4) return false;
        const std::uint32_t length = head[0] | head[1] << 8 | head[2] << 16 | static_cast<std::uint32_t>(head[3]) << 24;
        std::string content(length, '\0');
        if (std::fread(&content[0], 1, length, stdin) < length) return false;
        message = Reader(content).read();
        return true;
    }
    void send(const Writer &writer) {
        const auto length = static_cast<std::uint32_t>(writer.content.size());
        const unsigned char head[4] = {static_cast<unsigned char>(length), static_cast<unsigned char>(length >> 8),
                                       static_cast<unsigned char>(length >> 16), static_cast<unsigned char>(length >> 24)};
        std::fwrite(head, 1, 4, output_);
        std::fwrite(writer.content.data(), 1, length, output_);
        std::fflush(output_);
    }

  private:
    std::FILE *output_;
};

inline Batch read_batch(const Value &message, const Value &options) {
    Batch batch;
    batch.scenarios = static_cast<std::size_t>(message["scenarios"].number);
    batch.time_step = message["time_step"].number;
    batch.ego = message["ego"];
    batch.values = message["values"].items;
    for (const Value &seed : message["seeds"].items) batch.seeds.push_back(static_cast<std::uint64_t>(seed.number));
    batch.friction = message["friction"].doubles();
    for (const auto &parameter : message["parameters"].fields)
        batch.parameters[parameter.first] = parameter.second.doubles();
    batch.options = options;
    return batch;
}

inline void read_step(const Value &message, Step &step) {
    step.time = message["time"].number;
    step.time_step = message["time_step"].number;
    step.scenarios.clear();
    for (const Value &number : message["scenarios"].items) step.scenarios.push_back(static_cast<std::size_t>(number.number));
    step.columns.clear();
    for (const auto &column : message["columns"].fields) step.columns[column.first] = column.second.doubles();
    if (message.has("others")) {
        step.others.clear();
        for (const Value &other : message["others"].items)
            step.others.push_back({other["name"].text, other["object_type"].text, other["length"].number,
                                   other["width"].number, other["center_x"].number});
    }
    step.signals.clear();
    if (message.has("signals"))
        for (const auto &signal : message["signals"].fields)
            for (const Value &state : signal.second.items) step.signals[signal.first].push_back(state.text);
}

inline Writer write_failures(Writer writer, const std::map<std::size_t, std::string> &failures) {
    writer.text("failures").array(failures.size());
    for (const auto &failure : failures) writer.array(2).integer(failure.first).text(failure.second);
    return writer;
}

inline Writer write_controls(const Controls &controls) {
    Writer writer;
    writer.map(8).text("type").text("control");
    writer.text("acceleration").doubles(controls.acceleration).text("steering").doubles(controls.steering);
    writer.text("throttle").doubles(controls.throttle).text("brake").doubles(controls.brake);
    writer.text("lane_change").doubles(controls.lane_change).text("trajectories").array(controls.trajectories.size());
    for (const auto &trajectory : controls.trajectories) {
        writer.array(4).integer(trajectory.first);
        for (const auto &column : trajectory.second) writer.doubles(column);
    }
    return write_failures(writer, controls.failures);
}

// Answers cornercase until it closes the connection; returns the exit code of the program. `columns` are those that the
// function needs, none for all; `ahead` are the distances in m at which the path is sent. `option_names` are those of
// the function's options, so that cornercase refuses others; none if any may be given.
template <class Function>
int serve(Function function, const std::vector<std::string> &columns = {}, const std::vector<double> &ahead = {},
          const std::vector<std::string> &option_names = {}) {
    try {
        Connection connection;
        Value message, options;
        Step step;
        while (connection.receive(message)) {
            const std::string type = message["type"].text;
            if (type == "hello") {
                options = message["options"];
                Writer hello;
                hello.map(3 + !columns.empty() + !option_names.empty());
                hello.text("type").text("hello").text("protocol").integer(protocol_version);
                hello.text("ahead").array(ahead.size());
                for (double distance : ahead) hello.number(distance);
                if (!columns.empty()) {
                    hello.text("columns").array(columns.size());
                    for (const std::string &name : columns) hello.text(name);
                }
                if (!option_names.empty()) {
                    hello.text("options").array(option_names.size());
                    for (const std::string &name : option_names) hello.text(name);
                }
                connection.send(hello);
            } else if (type == "start") {
                function.start(read_batch(message, options));
                Writer ready;
                ready.map(1).text("type").text("ready");
                connection.send(ready);
            } else if (type == "step") {
                read_step(message, step);
                Controls controls(step.size());
                function.step(step, controls);
                connection.send(write_controls(controls));
            }
        }
        return 0;
    } catch (const std::exception &error) {
        std::fprintf(stderr, "%s\n", error.what());
        return 1;
    }
}

}  // namespace cornercase

#endif
