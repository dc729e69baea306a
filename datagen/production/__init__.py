"""Making scenes: plan and workers, one scene, one view, denoising, finishing."""
