"""The programs `ces NAME`: command lines go in; files, tables on the terminal and an exit status come out.

`main` finds a program's module by its name. A room holds the programs of one topic; `terminal` is what all share.
"""
