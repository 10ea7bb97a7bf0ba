// SPDX-License-Identifier: MIT
#include "graph/cholesky/multifrontal.hpp"

#include <algorithm>
#include <atomic>
#include <condition_variable>
#include <exception>
#include <limits>
#include <memory>
#include <mutex>
#include <thread>

#include "util/isa.hpp"

namespace heliograph {

namespace {

FrontKernels kernels() {
#if defined(HELIOGRAPH_HAVE_AVX2)
  if (active_isa() == Isa::avx2) return avx2_front_kernels();
#endif
  return baseline_front_kernels();
}

// Subtrees small enough to be one thread's piece of work, and the fronts above them one by one. Task t runs the fronts
// [begin[t], end[t]); it may start when `waits[t]` others have ended.
struct Tasks {
  std::vector<int32_t> begin, end, parent, waits;
};

Tasks split(const Plan& plan, int threads) {
  const size_t n = plan.fronts.size();
  std::vector<double> work(n, 0.0);
  std::vector<int32_t> first(n), task_of(n, -1);
  for (size_t s = 0; s < n; ++s) {
    const FrontView& front = plan.fronts[s];
    const double k = front.pivots, m = front.rows;
    work[s] += 1000.0 + k * (k + m) * (k + m);
    first[s] = static_cast<int32_t>(s);
    if (front.child_begin < front.child_end)
      first[s] = first[static_cast<size_t>(plan.children[static_cast<size_t>(front.child_begin)])];
    if (front.parent >= 0) work[static_cast<size_t>(front.parent)] += work[s];
  }
  double total = 0.0;
  for (size_t s = 0; s < n; ++s)
    if (plan.fronts[s].parent < 0) total += work[s];
  const double limit = total / (8.0 * threads);
  Tasks tasks;
  for (size_t s = 0; s < n; ++s) {
    const int32_t parent = plan.fronts[s].parent;
    if (work[s] <= limit && parent >= 0 && work[static_cast<size_t>(parent)] <= limit) continue;  // inside a larger piece
    task_of[s] = static_cast<int32_t>(tasks.begin.size());
    tasks.begin.push_back(work[s] <= limit ? first[s] : static_cast<int32_t>(s));
    tasks.end.push_back(static_cast<int32_t>(s) + 1);
  }
  tasks.parent.assign(tasks.begin.size(), -1);
  tasks.waits.assign(tasks.begin.size(), 0);
  for (size_t t = 0; t < tasks.begin.size(); ++t) {
    const int32_t parent = plan.fronts[static_cast<size_t>(tasks.end[t]) - 1].parent;
    if (parent < 0) continue;
    tasks.parent[t] = task_of[static_cast<size_t>(parent)];
    ++tasks.waits[static_cast<size_t>(tasks.parent[t])];
  }
  return tasks;
}

// Hands out tasks whose children have ended.
class Queue {
 public:
  explicit Queue(Tasks tasks) : tasks_(std::move(tasks)), left_(tasks_.begin.size()) {
    for (size_t t = tasks_.begin.size(); t-- > 0;)
      if (tasks_.waits[t] == 0) ready_.push_back(static_cast<int32_t>(t));
  }

  template <typename Run>
  void work(Run&& run) {
    std::unique_lock lock(mutex_);
    while (true) {
      wake_.wait(lock, [&] { return !ready_.empty() || left_ == 0; });
      if (ready_.empty()) return;
      const auto t = static_cast<size_t>(ready_.back());
      ready_.pop_back();
      lock.unlock();
      std::exception_ptr failure;
      try {
        run(tasks_.begin[t], tasks_.end[t]);
      } catch (...) {
        failure = std::current_exception();
      }
      lock.lock();
      if (failure) {  // nobody waits for what now never comes
        if (!failure_) failure_ = failure;
        ready_.clear();
        left_ = 0;
        wake_.notify_all();
        return;
      }
      if (left_ == 0) return;
      --left_;
      const int32_t parent = tasks_.parent[t];
      if (parent >= 0 && --tasks_.waits[static_cast<size_t>(parent)] == 0) ready_.push_back(parent);
      wake_.notify_all();
    }
  }

  size_t tasks() const { return tasks_.begin.size(); }

  void rethrow() const {
    if (failure_) std::rethrow_exception(failure_);
  }

 private:
  Tasks tasks_;
  size_t left_;
  std::exception_ptr failure_;
  std::vector<int32_t> ready_;
  std::mutex mutex_;
  std::condition_variable wake_;
};

}  // namespace

Multifrontal::Multifrontal(const Plan& plan)
    : plan_(plan), view_(plan.view()), kernels_(kernels()), factor_(static_cast<size_t>(plan.factor_size)),
      diagonal_(static_cast<size_t>(plan.scalars)), updates_(plan.fronts.size()), scratch_(static_cast<size_t>(kScratch)),
      rows_(static_cast<size_t>(plan.largest_rows) + 8) {}

int64_t Multifrontal::factorize(double damping, double damping_floor, int threads) {
  const Assembly assembly{damping, damping_floor, diagonal_.data()};
  return threads > 1 ? run_tasks(assembly, threads) : run_in_order(assembly);
}

int64_t Multifrontal::run_in_order(const Assembly& assembly) {
  for (size_t side = 0; side < 2; ++side) arena_[side].resize(static_cast<size_t>(plan_.arena_size[side]));
  for (size_t s = 0; s < plan_.fronts.size(); ++s) {
    const FrontView& front = plan_.fronts[s];
    updates_[s] = arena_[static_cast<size_t>(front.side)].data() + front.update;
    const int failed = kernels_.eliminate(view_, static_cast<int32_t>(s), assembly, factor_.data() + front.factor, updates_.data(),
                                          scratch_.data());
    if (failed >= 0) return front.first_pivot + failed;
  }
  return -1;
}

int64_t Multifrontal::run_tasks(const Assembly& assembly, int threads) {
  // Threads do not keep a stack's order, so every remainder lives in memory of its own until its parent has taken it.
  std::vector<std::unique_ptr<double[]>> own(plan_.fronts.size());
  Queue queue(split(plan_, threads));
  std::atomic<int64_t> failure{std::numeric_limits<int64_t>::max()};
  const auto worker = [&] {
    std::vector<double> scratch;
    queue.work([&](int32_t begin, int32_t end) {
      scratch.resize(static_cast<size_t>(kScratch));
      for (int32_t s = begin; s < end; ++s) {
        const FrontView& front = plan_.fronts[static_cast<size_t>(s)];
        const size_t size = static_cast<size_t>(front.update_height) * static_cast<size_t>(front.rows);
        own[static_cast<size_t>(s)] = std::make_unique_for_overwrite<double[]>(size);
        updates_[static_cast<size_t>(s)] = own[static_cast<size_t>(s)].get();
        const int failed = kernels_.eliminate(view_, s, assembly, factor_.data() + front.factor, updates_.data(), scratch.data());
        for (int32_t c = front.child_begin; c < front.child_end; ++c)
          own[static_cast<size_t>(plan_.children[static_cast<size_t>(c)])].reset();
        if (failed < 0) continue;
        // The first failure in elimination order is reported, whichever thread met one first.
        int64_t known = failure.load();
        const int64_t at = front.first_pivot + failed;
        while (at < known && !failure.compare_exchange_weak(known, at)) {
        }
      }
    });
  };
  {
    std::vector<std::jthread> pool;
    const size_t workers = std::min(static_cast<size_t>(threads), queue.tasks());
    for (size_t i = 1; i < workers; ++i) pool.emplace_back(worker);
    worker();
  }
  queue.rethrow();
  return failure.load() == std::numeric_limits<int64_t>::max() ? -1 : failure.load();
}

void Multifrontal::back_substitute(const double* y, double* x) const {
  for (size_t s = plan_.fronts.size(); s-- > 0;) {
    const FrontView& front = plan_.fronts[s];
    size_t n = 0;
    for (int32_t i = front.node_begin + front.node_pivots; i < front.node_end; ++i) {
      const auto node = static_cast<size_t>(plan_.nodes[static_cast<size_t>(i)]);
      const double* from = x + plan_.scalar_of[node];
      for (int32_t c = 0; c < plan_.weight[node]; ++c) rows_[n++] = from[c];
    }
    kernels_.back_substitute(front, factor_.data() + front.factor, y == nullptr ? nullptr : y + front.first_pivot, rows_.data(),
                             x + front.first_pivot);
  }
}

void Multifrontal::solve(std::span<double> x) const { back_substitute(nullptr, x.data()); }

double Multifrontal::gradient_energy() const {
  double sum = 0.0;
  for (const FrontView& front : plan_.fronts) {
    const double* y = factor_.data() + front.factor + front.pivots + front.rows;
    for (int32_t c = 0; c < front.pivots; ++c) sum += y[int64_t{c} * front.height] * y[int64_t{c} * front.height];
  }
  return sum;
}

void Multifrontal::solve_for(std::span<double> b) const {
  for (size_t s = 0; s < plan_.fronts.size(); ++s)
    kernels_.forward_substitute(view_, static_cast<int32_t>(s), factor_.data(), b.data());
  const std::vector<double> y(b.begin(), b.end());
  back_substitute(y.data(), b.data());
  for (double& value : b) value = -value;
}

}  // namespace heliograph
