"""The model's commands; they import torch only when they run."""
