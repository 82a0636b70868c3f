#!/bin/sh
# install.sh BUILD PREFIX: puts libgloaming from the Cargo build folder BUILD, with what C, C++, Fortran, pkg-config and CMake
# need, under PREFIX.
set -eu
build=$1
mkdir -p "$2"
prefix=$(cd "$2" && pwd)
here=$(cd "$(dirname "$0")/.." && pwd)
version=$(sed -n 's/^version = "\(.*\)"/\1/p' "$here/../../Cargo.toml" | head -n 1)
lib=$prefix/lib
mkdir -p "$lib/pkgconfig" "$lib/cmake/gloaming" "$prefix/include" "$prefix/share/gloaming"

if [ "$(uname)" = Darwin ]; then
    shared=libgloaming.dylib
    install -m 755 "$build/libgloaming_c.dylib" "$lib/$shared"
    command -v install_name_tool >/dev/null && install_name_tool -id "$lib/$shared" "$lib/$shared"
else
    shared=libgloaming.so
    install -m 755 "$build/libgloaming_c.so" "$lib/$shared.$version"
    ln -sf "$shared.$version" "$lib/$shared.0"
    ln -sf "$shared.0" "$lib/$shared"
fi
install -m 644 "$build/libgloaming_c.a" "$lib/libgloaming.a"
install -m 644 "$here/include/gloaming.h" "$here/include/gloaming.hpp" "$prefix/include"
# A module file belongs to one compiler: Fortran programs compile this source with their own.
install -m 644 "$here/include/gloaming.f90" "$prefix/share/gloaming"

hdf5=$(pkg-config --libs hdf5 2>/dev/null || pkg-config --libs hdf5-serial 2>/dev/null || echo -lhdf5)
if [ "$(uname)" = Darwin ]; then
    private="$hdf5 -lc++ -lm -framework Foundation -framework Metal -framework QuartzCore -framework CoreGraphics"
else
    private="$hdf5 -lstdc++ -lgcc_s -lutil -lrt -lpthread -lm -ldl -lc"
fi
fill() {
    sed -e "s|@VERSION@|$version|g" -e "s|@PRIVATE@|$private|g" -e "s|@SHARED@|$shared|g" "$here/install/$1" >"$2"
}
fill gloaming.pc.in "$lib/pkgconfig/gloaming.pc"
fill gloamingConfig.cmake.in "$lib/cmake/gloaming/gloamingConfig.cmake"
fill gloamingConfigVersion.cmake.in "$lib/cmake/gloaming/gloamingConfigVersion.cmake"
