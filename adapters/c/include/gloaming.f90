! gloaming for Fortran 2003 and later: the C interface of gloaming.h through ISO_C_BINDING, and a few procedures that take
! Fortran arrays and strings. Compile this file with your own compiler and link libgloaming. Rules and lifetimes are those
! of gloaming.h.
module gloaming
    use, intrinsic :: iso_c_binding
    implicit none
    private

    integer(c_int32_t), parameter, public :: GLOAMING_OK = 0, GLOAMING_SKIPPED = -1, GLOAMING_DROPPED = -2
    integer(c_int32_t), parameter, public :: GLOAMING_IO = 1, GLOAMING_FORMAT = 2, GLOAMING_SCENE = 3
    integer(c_int32_t), parameter, public :: GLOAMING_UNSUPPORTED = 4, GLOAMING_OUT_OF_MEMORY = 5, GLOAMING_DEVICE = 6
    integer(c_int32_t), parameter, public :: GLOAMING_CLOSED = 7, GLOAMING_BUG = 8, GLOAMING_ARGUMENT = 9
    integer(c_int32_t), parameter, public :: GLOAMING_OTHER = 99
    integer(c_int32_t), parameter, public :: GLOAMING_U8 = 1, GLOAMING_I8 = 2, GLOAMING_U16 = 3, GLOAMING_I16 = 4
    integer(c_int32_t), parameter, public :: GLOAMING_U32 = 5, GLOAMING_I32 = 6, GLOAMING_U64 = 7, GLOAMING_I64 = 8
    integer(c_int32_t), parameter, public :: GLOAMING_F16 = 9, GLOAMING_F32 = 10, GLOAMING_F64 = 11

    type, bind(c), public :: gloaming_error
        integer(c_int32_t) :: code = 0
        character(kind=c_char) :: message(1020) = c_null_char
    end type

    ! How values lie in memory and in space: see gloaming.h. Dense Fortran arrays a(x, y, z) need no strides.
    type, bind(c), public :: gloaming_block
        integer(c_size_t) :: dims(3) = 0
        integer(c_ptrdiff_t) :: strides(3) = 0
        integer(c_size_t) :: start(3) = 0
        integer(c_size_t) :: size(3) = 0
        real(c_double) :: spacing(3) = 0
        real(c_double) :: origin(3) = 0
        integer(c_int32_t) :: type = 0
    end type

    type, bind(c), public :: gloaming_stats
        integer(c_int64_t) :: pushed = 0, lit = 0, lost = 0, dropped = 0, skipped = 0, waiting = 0, bytes = 0
        real(c_double) :: held_ms = 0, longest_held_ms = 0
    end type

    public :: gloaming_open, gloaming_open_file, gloaming_push, gloaming_push_block, gloaming_push_owned
    public :: gloaming_flush, gloaming_save_light, gloaming_get_stats, gloaming_close, gloaming_message

    ! gloaming_push(session, step, time, values [, ghosts] [, spacing] [, origin] [, error]) of a dense array, the same number of
    ! ghost layers on each side left out. The values are copied before it returns.
    interface gloaming_push
        module procedure push_real32, push_real64
    end interface

    interface
        function c_open(config, error) bind(c, name="gloaming_open") result(session)
            import :: c_ptr
            type(c_ptr), value :: config, error
            type(c_ptr) :: session
        end function
        function c_open_file(path, error) bind(c, name="gloaming_open_file") result(session)
            import :: c_ptr
            type(c_ptr), value :: path, error
            type(c_ptr) :: session
        end function
        function c_save_light(session, path, error) bind(c, name="gloaming_save_light") result(code)
            import :: c_ptr, c_int32_t
            type(c_ptr), value :: session, path, error
            integer(c_int32_t) :: code
        end function
        function gloaming_push_block(session, step, time, block, values, error) bind(c) result(code)
            import :: c_ptr, c_int32_t, c_int64_t, c_double, gloaming_block, gloaming_error
            type(c_ptr), value :: session, values
            integer(c_int64_t), value :: step
            real(c_double), value :: time
            type(gloaming_block), intent(in) :: block
            type(gloaming_error), intent(out), optional :: error
            integer(c_int32_t) :: code
        end function
        function gloaming_push_owned(session, step, time, block, values, release, user, error) bind(c) result(code)
            import :: c_ptr, c_funptr, c_int32_t, c_int64_t, c_double, gloaming_block, gloaming_error
            type(c_ptr), value :: session, values, user
            type(c_funptr), value :: release
            integer(c_int64_t), value :: step
            real(c_double), value :: time
            type(gloaming_block), intent(in) :: block
            type(gloaming_error), intent(out), optional :: error
            integer(c_int32_t) :: code
        end function
        function gloaming_flush(session, error) bind(c) result(code)
            import :: c_ptr, c_int32_t, gloaming_error
            type(c_ptr), value :: session
            type(gloaming_error), intent(out), optional :: error
            integer(c_int32_t) :: code
        end function
        function gloaming_get_stats(session, stats, error) bind(c) result(code)
            import :: c_ptr, c_int32_t, gloaming_stats, gloaming_error
            type(c_ptr), value :: session
            type(gloaming_stats), intent(out) :: stats
            type(gloaming_error), intent(out), optional :: error
            integer(c_int32_t) :: code
        end function
        function gloaming_close(session, stats, error) bind(c) result(code)
            import :: c_ptr, c_int32_t, gloaming_stats, gloaming_error
            type(c_ptr), value :: session
            type(gloaming_stats), intent(out), optional :: stats
            type(gloaming_error), intent(out), optional :: error
            integer(c_int32_t) :: code
        end function
    end interface

contains

    ! Opens a session from the text of a scene file with an [insitu] table; lines end in new_line('a'). c_null_ptr on failure.
    function gloaming_open(config, error) result(session)
        character(*), intent(in) :: config
        type(gloaming_error), intent(out), target, optional :: error
        type(c_ptr) :: session
        character(kind=c_char), target :: text(len(config) + 1)
        type(c_ptr) :: told
        call to_c(config, text)
        told = c_null_ptr
        if (present(error)) told = c_loc(error)
        session = c_open(c_loc(text), told)
    end function

    ! Opens a session from the scene file at a path. c_null_ptr on failure.
    function gloaming_open_file(path, error) result(session)
        character(*), intent(in) :: path
        type(gloaming_error), intent(out), target, optional :: error
        type(c_ptr) :: session
        character(kind=c_char), target :: text(len(path) + 1)
        type(c_ptr) :: told
        call to_c(path, text)
        told = c_null_ptr
        if (present(error)) told = c_loc(error)
        session = c_open_file(c_loc(text), told)
    end function

    ! Keeps the light of the steps pushed so far in a file, for a restarted run to go on from.
    function gloaming_save_light(session, path, error) result(code)
        type(c_ptr), intent(in) :: session
        character(*), intent(in) :: path
        type(gloaming_error), intent(out), target, optional :: error
        integer(c_int32_t) :: code
        character(kind=c_char), target :: text(len(path) + 1)
        type(c_ptr) :: told
        call to_c(path, text)
        told = c_null_ptr
        if (present(error)) told = c_loc(error)
        code = c_save_light(session, c_loc(text), told)
    end function

    subroutine to_c(string, text)
        character(*), intent(in) :: string
        character(kind=c_char), intent(out) :: text(:)
        integer :: i, n
        text = c_null_char
        n = len_trim(string)
        do i = 1, n
            text(i) = string(i:i)
        end do
    end subroutine

    function push_real32(session, step, time, values, ghosts, spacing, origin, error) result(code)
        type(c_ptr), intent(in) :: session
        integer, intent(in) :: step
        real(c_double), intent(in) :: time
        real(c_float), intent(in), target, contiguous :: values(:, :, :)
        integer, intent(in), optional :: ghosts
        real(c_double), intent(in), optional :: spacing(3), origin(3)
        type(gloaming_error), intent(out), optional :: error
        integer(c_int32_t) :: code
        type(gloaming_block) :: block
        block = dense(shape(values), GLOAMING_F32, ghosts, spacing, origin)
        code = gloaming_push_block(session, int(step, c_int64_t), time, block, c_loc(values), error)
    end function

    function push_real64(session, step, time, values, ghosts, spacing, origin, error) result(code)
        type(c_ptr), intent(in) :: session
        integer, intent(in) :: step
        real(c_double), intent(in) :: time
        real(c_double), intent(in), target, contiguous :: values(:, :, :)
        integer, intent(in), optional :: ghosts
        real(c_double), intent(in), optional :: spacing(3), origin(3)
        type(gloaming_error), intent(out), optional :: error
        integer(c_int32_t) :: code
        type(gloaming_block) :: block
        block = dense(shape(values), GLOAMING_F64, ghosts, spacing, origin)
        code = gloaming_push_block(session, int(step, c_int64_t), time, block, c_loc(values), error)
    end function

    function dense(dims, type, ghosts, spacing, origin) result(block)
        integer, intent(in) :: dims(3)
        integer(c_int32_t), intent(in) :: type
        integer, intent(in), optional :: ghosts
        real(c_double), intent(in), optional :: spacing(3), origin(3)
        type(gloaming_block) :: block
        block%dims = int(dims, c_size_t)
        block%type = type
        if (present(ghosts)) then
            block%start = int(ghosts, c_size_t)
            block%size = int(max(dims - 2*ghosts, 0), c_size_t)
        end if
        if (present(spacing)) block%spacing = spacing
        if (present(origin)) block%origin = origin
    end function

    ! The message of an error as a Fortran string.
    function gloaming_message(error) result(message)
        type(gloaming_error), intent(in) :: error
        character(:), allocatable :: message
        integer :: i
        message = ""
        do i = 1, size(error%message)
            if (error%message(i) == c_null_char) exit
            message = message // error%message(i)
        end do
    end function
end module
