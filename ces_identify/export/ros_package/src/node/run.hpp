// Runs one node as a program of its own.
#ifndef NODE__RUN_HPP_
#define NODE__RUN_HPP_

namespace ces
{

// Build the node and run it; returns the exit status: 0 after a signal, 2 with one FATAL line if it cannot be built.
int run_observer(int argc, char ** argv);

}  // namespace ces

#endif  // NODE__RUN_HPP_
