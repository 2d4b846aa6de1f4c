/* What the library was built from: a digest of all native sources, given by the build script. */
const char *native_sources(void) { return NATIVE_SOURCES; }
