// SPDX-License-Identifier: MIT
// Runs a function over chunks on a few threads. The caller takes chunks too and then joins: it never spins, because on a
// small machine a spinning caller keeps the worker it waits for off the core.
#pragma once
#include <algorithm>
#include <atomic>
#include <cstddef>
#include <exception>
#include <mutex>
#include <thread>
#include <vector>

namespace heliograph {

// Calls run(chunk) once for each chunk in [0, chunks), on up to `threads` threads, in no fixed order. A caller that wants
// the same bits at any thread count writes one result a chunk and adds them up in order afterwards. What a call throws is
// thrown again here once all threads have ended.
template <typename Run>
void parallel_chunks(size_t chunks, int threads, Run&& run) {
  const size_t workers = threads > 1 ? std::min<size_t>(static_cast<size_t>(threads), chunks) : 1;
  if (workers <= 1) {
    for (size_t chunk = 0; chunk < chunks; ++chunk) run(chunk);
    return;
  }
  std::atomic<size_t> next{0};
  std::exception_ptr failure;
  std::once_flag first;
  const auto work = [&] {
    try {
      for (size_t chunk = next.fetch_add(1); chunk < chunks; chunk = next.fetch_add(1)) run(chunk);
    } catch (...) {
      std::call_once(first, [&] { failure = std::current_exception(); });
      next.store(chunks);
    }
  };
  {
    std::vector<std::jthread> pool;
    pool.reserve(workers - 1);
    for (size_t i = 1; i < workers; ++i) pool.emplace_back(work);
    work();
  }
  if (failure) std::rethrow_exception(failure);
}

}  // namespace heliograph
