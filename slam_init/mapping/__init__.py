"""Maps: from poses to landmarks, and how they grow, are followed, joined and found again."""
