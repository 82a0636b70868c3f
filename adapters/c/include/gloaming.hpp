// gloaming for C++14 and later: gloaming.h with a session that closes itself. Rules and lifetimes are those of gloaming.h.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <stdexcept>
#include <string>
#include <utility>

#include "gloaming.h"

namespace gloaming {

// Thrown by the constructor alone: once a session is open, codes tell what went wrong, and a simulation may ignore them.
class Error : public std::runtime_error {
public:
    explicit Error(const gloaming_error& error) : std::runtime_error(error.message), code(error.code) {}
    const int code;
};

template <typename T> struct type_of;
template <> struct type_of<std::uint8_t> { static constexpr std::int32_t value = GLOAMING_U8; };
template <> struct type_of<std::int8_t> { static constexpr std::int32_t value = GLOAMING_I8; };
template <> struct type_of<std::uint16_t> { static constexpr std::int32_t value = GLOAMING_U16; };
template <> struct type_of<std::int16_t> { static constexpr std::int32_t value = GLOAMING_I16; };
template <> struct type_of<std::uint32_t> { static constexpr std::int32_t value = GLOAMING_U32; };
template <> struct type_of<std::int32_t> { static constexpr std::int32_t value = GLOAMING_I32; };
template <> struct type_of<std::uint64_t> { static constexpr std::int32_t value = GLOAMING_U64; };
template <> struct type_of<std::int64_t> { static constexpr std::int32_t value = GLOAMING_I64; };
template <> struct type_of<float> { static constexpr std::int32_t value = GLOAMING_F32; };
template <> struct type_of<double> { static constexpr std::int32_t value = GLOAMING_F64; };

// A block of T, dense and x fastest, everything shown; change what differs.
template <typename T> gloaming_block block(std::array<std::size_t, 3> dims) {
    gloaming_block b = {};
    for (int a = 0; a < 3; ++a) b.dims[a] = dims[a];
    b.type = type_of<T>::value;
    return b;
}

class Session {
public:
    explicit Session(const std::string& config) {
        gloaming_error error;
        session_ = gloaming_open(config.c_str(), &error);
        if (!session_) throw Error(error);
    }
    Session(Session&& other) noexcept : session_(std::exchange(other.session_, nullptr)) {}
    Session(const Session&) = delete;
    Session& operator=(Session other) noexcept {
        std::swap(session_, other.session_);
        return *this;
    }
    ~Session() {
        if (session_) gloaming_close(session_, nullptr, nullptr);
    }

    // Copies the values before it returns.
    template <typename T>
    int push(std::uint64_t step, double time, const gloaming_block& block, const T* values, gloaming_error* error = nullptr) {
        return gloaming_push_block(session_, step, time, &block, values, error);
    }

    // Gives a container away (std::vector<float>, say): nothing is copied, and it is destroyed when the step is done with.
    template <typename Container>
    int give(std::uint64_t step, double time, const gloaming_block& block, Container values, gloaming_error* error = nullptr) {
        auto* kept = new Container(std::move(values));
        return gloaming_push_owned(
            session_, step, time, &block, kept->data(), [](void* c) { delete static_cast<Container*>(c); }, kept, error);
    }

    int flush(gloaming_error* error = nullptr) { return gloaming_flush(session_, error); }

    // Keeps the light of the steps so far in a file, for a restarted run to go on from.
    int save_light(const std::string& path, gloaming_error* error = nullptr) {
        return gloaming_save_light(session_, path.c_str(), error);
    }

    gloaming_stats stats() const {
        gloaming_stats stats = {};
        gloaming_get_stats(session_, &stats, nullptr);
        return stats;
    }

    // Closes every file; the destructor does so too, without telling how it went.
    gloaming_stats close(gloaming_error* error = nullptr) {
        gloaming_stats stats = {};
        gloaming_close(std::exchange(session_, nullptr), &stats, error);
        return stats;
    }

private:
    gloaming_session* session_ = nullptr;
};

}  // namespace gloaming
