"""Decision rules: the previews of a frame, the window with its risk, the check of the stated focal length."""
