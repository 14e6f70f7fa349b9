// The same emergency brake in C++17; it needs cornercase_client.hpp beside it.
//     g++ -O2 -std=c++17 aeb.cpp -o aeb
#include "cornercase_client.hpp"

struct Aeb {
    cornercase::Batch batch;

    void start(const cornercase::Batch &started) { batch = started; }

    void step(const cornercase::Step &step, cornercase::Controls &controls) {
        const auto &gap = step.column("leader_gap"), &closing = step.column("leader_closing");
        for (std::size_t row = 0; row < step.size(); ++row) {
            // An option may differ between scenarios if it is a dimension of a search.
            const double time_to_brake = batch.option("time_to_brake", 1.5, step.scenarios[row]);
            // The gap is NaN without a leader.
            controls.acceleration[row] = gap[row] < time_to_brake * closing[row] ? -8.0 : 0.0;
        }
    }
};

int main() { return cornercase::serve(Aeb{}, {"leader_gap", "leader_closing"}, {}, {"time_to_brake"}); }
