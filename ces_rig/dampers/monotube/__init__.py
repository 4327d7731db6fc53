"""The mono-tube damper with shim stacks and a piloted spool in its piston: for sealed tests only."""
