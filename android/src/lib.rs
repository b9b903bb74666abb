//! The Android application.
