// The program `observer`: the node with an executor of its own.

namespace ces {
int run_observer(int argc, char ** argv);
}

int main(int argc, char ** argv) {return ces::run_observer(argc, argv);}
