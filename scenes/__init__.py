"""What is there: assets, materials, placement, cameras and the frozen `SceneSpec` that names them all."""
