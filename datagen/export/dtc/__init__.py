"""The published DTC-MultiLight layouts, in 2D and 3D, as MV-CoLight's own code reads them."""
