// wave N STEPS [CONFIG]: waves in a box, from C++. d2u/dt2 = c2 Laplacian(u), leapfrog, walls that reflect; what is shown is
// the energy in f64, given away step by step, so that nothing is copied. Prints a hash of the last step, which is the same
// with and without gloaming.
//
//   c++ -O2 wave.cpp $(pkg-config --cflags --libs gloaming) -o wave && ./wave 64 100 wave.toml
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <memory>
#include <sstream>
#include <vector>

#include "gloaming.hpp"
#include "held.h"

class Wave {
public:
    explicit Wave(std::size_t n) : n_(n), now_(n * n * n), before_(now_) {
        for_each([&](std::size_t c, double x, double y, double z) {
            double r2 = (x - 0.3) * (x - 0.3) + (y - 0.5) * (y - 0.5) + (z - 0.6) * (z - 0.6);
            now_[c] = before_[c] = 3.0 * std::exp(-r2 * 20.0);
        });
    }

    void step() {
        std::vector<double> next(now_.size());
        const std::size_t row = n_, slice = n_ * n_;
        for (std::size_t k = 0; k < n_; ++k)
            for (std::size_t j = 0; j < n_; ++j)
                for (std::size_t i = 0; i < n_; ++i) {
                    const std::size_t c = k * slice + j * row + i;
                    const double u = now_[c];
                    double sum = 0;
                    sum += i > 0 ? now_[c - 1] : u;
                    sum += i + 1 < n_ ? now_[c + 1] : u;
                    sum += j > 0 ? now_[c - row] : u;
                    sum += j + 1 < n_ ? now_[c + row] : u;
                    sum += k > 0 ? now_[c - slice] : u;
                    sum += k + 1 < n_ ? now_[c + slice] : u;
                    next[c] = 2 * u - before_[c] + 0.25 * (sum - 6 * u);
                }
        before_ = std::move(now_);
        now_ = std::move(next);
    }

    std::vector<double> energy() const {
        std::vector<double> e(now_.size());
        for (std::size_t c = 0; c < e.size(); ++c) e[c] = now_[c] * now_[c];
        return e;
    }

    std::uint64_t hash() const { return held_hash(now_.data(), now_.size() * sizeof(double)); }

private:
    template <typename F> void for_each(F f) const {
        for (std::size_t c = 0; c < now_.size(); ++c)
            f(c, double(c % n_) / n_, double(c / n_ % n_) / n_, double(c / (n_ * n_)) / n_);
    }
    std::size_t n_;
    std::vector<double> now_, before_;
};

int main(int argc, char** argv) {
    const std::size_t n = argc > 1 ? std::atoi(argv[1]) : 48;
    const int steps = argc > 2 ? std::atoi(argv[2]) : 48;
    std::unique_ptr<gloaming::Session> lit;
    if (argc > 3) {
        std::stringstream config;
        config << std::ifstream(argv[3]).rdbuf();
        try {
            lit.reset(new gloaming::Session(config.str()));
        } catch (const gloaming::Error& e) {
            std::fprintf(stderr, "without pictures: %s\n", e.what());
        }
    }
    Wave wave(n);
    for (int step = 0; step < steps; ++step) {
        wave.step();
        if (!lit) continue;
        std::vector<double> shown = wave.energy();
        const double copy = held_copy(shown.data(), shown.size() * sizeof(double)), begun = held_now();
        gloaming_error error;
        const int code = lit->give(step, 0.1 * step, gloaming::block<double>({n, n, n}), std::move(shown), &error);
        if (code == GLOAMING_OK) held_note(copy, held_now() - begun);
        if (code > 0) std::fprintf(stderr, "step %d: %s\n", step, error.message);
    }
    if (lit) {
        const gloaming_stats stats = lit->close();
        std::fprintf(stderr, "%llu steps lit, %llu bytes copied\n", (unsigned long long)stats.lit, (unsigned long long)stats.bytes);
        held_report("a vector given away");
    }
    std::printf("%016llx\n", (unsigned long long)wave.hash());
}
