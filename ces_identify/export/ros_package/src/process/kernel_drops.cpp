#include "process/kernel_drops.hpp"

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <system_error>
#include <vector>

namespace ces
{
namespace
{

namespace files = std::filesystem;

constexpr const char * TABLES[] = {"/proc/self/net/udp", "/proc/self/net/udp6"};
constexpr const char * SOCKET = "socket:[";
constexpr std::size_t MAX_SOCKETS = 10'000;  // lines of a table that are read
constexpr std::size_t INODE = 9, DROPS = 12;  // columns

std::set<std::string> find_own_sockets()
{
  std::set<std::string> inodes;
  std::error_code error;
  for (files::directory_iterator entry("/proc/self/fd", error), end; !error && entry != end; entry.increment(error)) {
    std::error_code closed;  // meanwhile
    const auto target = files::read_symlink(entry->path(), closed).string();
    const std::size_t length = std::string(SOCKET).size();
    if (!closed && target.rfind(SOCKET, 0) == 0) {inodes.insert(target.substr(length, target.size() - length - 1));}
  }
  return inodes;
}

std::uint64_t read_drops(const char * table, const std::set<std::string> & inodes)
{
  std::ifstream file(table);
  std::string line;
  std::uint64_t drops = 0;
  std::getline(file, line);
  for (std::size_t k = 0; k < MAX_SOCKETS && std::getline(file, line); ++k) {
    std::istringstream words(line);
    std::vector<std::string> columns;
    for (std::string word; words >> word; ) {columns.push_back(word);}
    if (columns.size() > DROPS && inodes.count(columns[INODE])) {
      drops += std::strtoull(columns[DROPS].c_str(), nullptr, 10);
    }
  }
  return drops;
}

}  // namespace

KernelDrops::KernelDrops()
: inodes_(find_own_sockets()), start_(count()) {}

void KernelDrops::update()
{
  const auto counted = count(), total = counted > start_ ? counted - start_ : 0;
  fresh_ = total > total_ ? total - total_ : 0;
  total_ = total;
}

std::uint64_t KernelDrops::count() const
{
  std::uint64_t drops = 0;
  for (const auto * table : TABLES) {drops += inodes_.empty() ? 0 : read_drops(table, inodes_);}
  return drops;
}

}  // namespace ces
