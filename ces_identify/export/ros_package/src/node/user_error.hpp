// A mistake of the user, in one line: what is wrong, where, what was expected and what to do.
#ifndef NODE__USER_ERROR_HPP_
#define NODE__USER_ERROR_HPP_

#include <stdexcept>

namespace ces
{

class UserError : public std::runtime_error
{
  using std::runtime_error::runtime_error;
};

}  // namespace ces

#endif  // NODE__USER_ERROR_HPP_
