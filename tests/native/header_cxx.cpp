// SPDX-License-Identifier: Apache-2.0
// shmtf.h compiles as C++ with warnings as errors, and its names are exported with C linkage.
#include <shmtf.h>

#include <cstdint>
#include <cstdio>
#include <cstring>

int main() {
    shmtf_config config;
    shmtf_config_default(&config);
    shmtf_error error;
    std::memset(&error, 0, sizeof error);
    const std::uint64_t size_bytes = shmtf_segment_size(&config, &error);
    const shmtf_ref ref = shmtf_by_name("base_link");
    std::printf("shmtf %s, default segment %llu bytes\n", shmtf_version(), static_cast<unsigned long long>(size_bytes));
    return size_bytes > 0 && std::strcmp(ref.name, "base_link") == 0 ? 0 : 1;
}
