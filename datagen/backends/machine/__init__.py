"""What this machine can render with: Dr.Jit variants, LLVM, and probes in processes of their own."""
