// The program `observer`: the node with an executor of its own.

#include "node/run.hpp"

int main(int argc, char ** argv) {return ces::run_observer(argc, argv);}
