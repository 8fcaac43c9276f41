"""The methods that users have today, beside ours: one small file each, one interface (`scene`)."""
