"""The rig live: a damper stepped tick by tick under commanded current, on a scripted stroke or under a vehicle."""
