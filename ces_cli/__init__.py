"""The programs `ces NAME`: command lines go in; files, tables on the terminal and an exit status come out.

`main` finds a program's module by its name. Each package holds the programs of one topic; all share `terminal`.
"""
