"""The LuxRemix set's layout."""
