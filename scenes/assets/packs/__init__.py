"""Where assets come from: installed packs, folders and backgrounds of the user."""
