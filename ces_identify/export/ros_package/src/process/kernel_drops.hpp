// Datagrams that the kernel dropped because this process did not read them in time, from the tables in /proc/net.
//
// A full receive buffer loses messages before DDS sees them. With shared memory instead of UDP nothing is counted.
#ifndef PROCESS__KERNEL_DROPS_HPP_
#define PROCESS__KERNEL_DROPS_HPP_

#include <cstdint>
#include <set>
#include <string>

namespace ces
{

// Counts the drops at the UDP sockets that the process has when this is made.
class KernelDrops
{
public:
  KernelDrops();

  // Count again.
  void update();

  std::uint64_t total() const {return total_;}
  std::uint64_t fresh() const {return fresh_;}  // between the last two updates

private:
  std::uint64_t count() const;

  std::set<std::string> inodes_;
  std::uint64_t start_, total_ = 0, fresh_ = 0;
};

}  // namespace ces

#endif  // PROCESS__KERNEL_DROPS_HPP_
